"""
Table of the lidar as built
===========================

The surveys behind the table of "The lidar as built" in LIDAR.md: RMS error and coverage of lit cells through the air,
and mean error under plants. With SIONNA_RADAR_SMALL=1 in the environment the flights are short and few.
"""

import os

from sionna_radar import load_scenario, run

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
SIZE = {"platform.length_m": 15.0, "terrain.spacing_m": 2.0} if SMALL else {}
AS_BUILT = {"wavelength_nm": 905, "model": "as_built"}
LIDARS = {
    "ideal, first": {"wavelength_nm": 905},
    "as built, first": AS_BUILT,
    "as built, last": {**AS_BUILT, "returns": "last"},
    "livox_avia, last": {"preset": "livox_avia", "returns": "last"},
}
AIRS = {
    "clear": {},
    "dust, 500 m": {"dust_visibility_m": 500.0},
    "dust, 200 m": {"dust_visibility_m": 200.0},
    "fog, 200 m": {"fog_visibility_m": 200.0},
    "rain, 50 mm/h": {"rain_rate_mm_per_h": 50.0},
}
FIELD = {"polygon_m": [[-150.0, -150.0], [150.0, -150.0], [150.0, 150.0], [-150.0, 150.0]]}
# Height and extinction of light; the radar's figures play no part.
PLANTS = [(10.0, 0.5), (10.0, 1.0), (2.0, 2.0)]


def flown(lidar, **changes):
    """Return the errors of the lit cells."""
    return run(load_scenario("hills", {"sensor": "lidar", "lidar": lidar, **SIZE, **changes})).lit_error


# %%
print("| air, plants | " + " | ".join(LIDARS) + " |")
for air, weather in list(AIRS.items())[: 2 if SMALL else None]:
    errors = [flown(lidar, weather=weather) for lidar in LIDARS.values()]
    print(f"| {air} | " + " | ".join(f"{each.rms_m:.3f} m, {each.coverage:.0%}" for each in errors) + " |")

# %%
for height_m, light_db_per_m in PLANTS[: 1 if SMALL else None]:
    stand = {**FIELD, "height_m": height_m, "light_extinction_db_per_m": light_db_per_m}
    stand |= {"extinction_db_per_m": 5.0, "backscatter_db_per_m": -20.0}
    means = [flown(LIDARS[f"as built, {end}"], vegetation=[stand]).mean_m for end in ("first", "last")]
    print(f"| {height_m:g} m of plants, {light_db_per_m:g} dB/m | | {means[0]:+.1f} m | {means[1]:+.1f} m | |")
