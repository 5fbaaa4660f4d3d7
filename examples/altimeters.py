"""
A radar as altimeter
====================

What altimeters of 24 and 77 GHz read over soil, grass, trees, water and slopes, and how low a flight that is steered by
what they read comes to what stands below. Makes the tables of `docs/checks/radar_altimeters.md`.
"""

from functools import partial

import numpy as np

from sionna_radar import CustomParts, Raster, load_scenario, prepare

SPEED_MPS, CHIRPS, TIME_CONSTANT_S, RESPONSE_S = 10.0, 25, 0.1, 1.0
RADARS = ("alt_24000", "alt_77000")
HIGHEST_M = {"alt_24000": 500.0, "alt_77000": 140.0}
SOIL = {
    "kind": "soil", "temperature_c": 15.0, "sand_percent": 40.0, "clay_percent": 20.0, "water_fraction": 0.2,
    "specific_gravity": 2.65,
}  # fmt: skip
WATER = {"kind": "water", "temperature_c": 10.0}
# Slopes of one direction: of soil 0.24; of water in 5 m/s half of 0.003 + 0.00512 times the wind (Cox and Munk 1954).
SURFACES = {
    "soil": {"model": "kirchhoff", "medium": SOIL, "rms_height_m": 0.02, "correlation_length_m": 0.12},
    "water": {
        "model": "kirchhoff",
        "medium": WATER,
        "rms_height_m": 0.1 * float(np.sqrt((0.003 + 0.00512 * 5.0) / 2 / 2)),
        "correlation_length_m": 0.1,
    },
    "calm water": {
        "model": "small_perturbation",
        "medium": WATER,
        "rms_height_m": 1e-5,
        "correlation_length_m": 0.01,
        "specular": True,
    },
}
# Heights of plants, and what they take, dB/m one way; trees as Schwering measured at 28.8 and 57.6 GHz.
PLANTS = {"grass": (0.5, {"alt_24000": 10.0, "alt_77000": 20.0}), "trees": (12.0, {"alt_24000": 1.3, "alt_77000": 2.0})}
WIDE_M, POST_M, LEVEL_M, LENGTH_M = 500.0, 2.0, 20.0, 240.0
# Readings until the tracker has forgotten the first.
SETTLED = 20
EAST_M = np.arange(-WIDE_M, WIDE_M + 1, POST_M)


def planned(radar, cover, height_m, ground_m, length_m, height="level"):
    """Return a survey at a height above a profile that is the same all across, before it is flown."""
    keys = {
        "platform": {"altitude_m": height_m, "speed_mps": SPEED_MPS, "length_m": length_m, "height": height},
        "platform.height_response_s": RESPONSE_S,
        "radar": {"preset": radar},
        "terrain.material": "below",
        "materials.below": SURFACES.get(cover, SURFACES["soil"]),
        "tracing.speckle": "per_pulse",
        "processing": {
            "ranging": "tracker",
            "ranging_parameters": {"time_constant_s": TIME_CONSTANT_S},
            "average": {"chirps": CHIRPS, "mode": "incoherent"},
            "cfar": {"kind": "CA"},
            "volume_clutter": "off",
            "min_range_m": 1.4,
        },
        "dem": {"method": "linear", "spacing_m": 25.0},
    }
    if cover in PLANTS:
        top_m, extinction = PLANTS[cover]
        corners_m = [(x * WIDE_M, y * WIDE_M / 2) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        keys["vegetation"] = [
            {
                "polygon_m": corners_m,
                "height_m": top_m,
                "extinction_db_per_m": extinction[radar],
                # A stand returns a twentieth of what it takes.
                "backscatter_db_per_m": float(10 * np.log10(0.05 * np.log(10) / 10 * extinction[radar])),
            }
        ]
    terrain = Raster.from_array(np.tile(ground_m(EAST_M), (int(WIDE_M / POST_M) + 1, 1)), POST_M)
    return prepare(load_scenario("hills", keys), CustomParts(terrain=terrain))


class Readings:
    """Where readings were made, how high the radar was, what it read, and the share of pulses without an echo."""

    def __init__(self, prepared):
        index = np.arange(len(prepared))
        echoes = prepared.echoes(index)
        self.east_m, _, self.up_m = prepared.flight.pulses(index).true.position_m[echoes.pulse].T
        self.read_m, self.missing = echoes.range_m, 1 - len(echoes.pulse) / len(index)


def level(east_m):
    return 0.0 * east_m


# %%
# Over level ground: reading less true height over the ground, its spread, and readings without an echo.
print("| radar | cover | 10 m | 30 m | 100 m | highest |")
for radar in RADARS:
    for cover in ("soil", "grass", "trees", "water", "calm water"):
        cells = []
        for height_m in (10.0, 30.0, 100.0, HIGHEST_M[radar]):
            if PLANTS.get(cover, (0.0,))[0] > height_m:
                cells.append("")
                continue
            made = Readings(planned(radar, cover, height_m, level, LEVEL_M))
            error_m = (made.read_m - made.up_m)[SETTLED:]
            cells.append(f"{error_m.mean():+.2f} ± {error_m.std():.2f}, {made.missing:.0%}")
        print(f"| {radar} | {cover} | " + " | ".join(cells) + " |", flush=True)


# %%
# Over slopes of soil, level, up and down. Half of the difference over the rate of the height is the delay.
def sloping_errors(radar, rise):
    """Return reading less height over the height."""
    made = Readings(planned(radar, "soil", 40.0, lambda east_m: rise * east_m, LEVEL_M))
    height_m = made.up_m - rise * made.east_m
    return np.mean((made.read_m / height_m - 1)[SETTLED:])


print("| radar | slope | reading less height | nearest point | delay |")
for radar in RADARS:
    for slope_deg in (10.0, 20.0, 30.0):
        rise, nearest = np.tan(np.deg2rad(slope_deg)), np.cos(np.deg2rad(slope_deg)) - 1
        up, down = sloping_errors(radar, rise), sloping_errors(radar, -rise)
        delay_s = (up - down) / 2 * 40.0 / (rise * SPEED_MPS)
        cells = f"{50 * (up + down):+.1f} % | {100 * nearest:+.1f} % | {delay_s:+.3f} s"
        print(f"| {radar} | {slope_deg:.0f} deg | {cells} |", flush=True)

# %%
# Over hills, steered by readings: the ground as it is read, followed by a first-order response, over what stands there.
SET_M = 30.0


def hills(east_m):
    """Return ridges of 8 m, 120 m apart, whose slopes reach 12 deg."""
    return 4.0 * np.sin(2 * np.pi * east_m / 120.0)


def lowest_m(top_m, ground_m, height):
    """Return the least height to set with which a flight that follows ground, as it is known, stays over the tops."""
    trajectory = planned(RADARS[0], "soil", SET_M, ground_m, LENGTH_M, height).flown.trajectory
    east_m, _, up_m = trajectory.position(np.linspace(0.0, trajectory.end_s, 1001)).T
    return SET_M - np.min(up_m - hills(east_m) - top_m)


print("| radar | cover | by its readings | by readings without error | by a DEM of the ground |")
for radar in RADARS:
    for cover in ("soil", "grass", "trees"):
        top_m = PLANTS.get(cover, (0.0,))[0]
        made = Readings(planned(radar, cover, SET_M, hills, LENGTH_M, "sensed"))
        as_read = partial(np.interp, xp=made.east_m, fp=made.up_m - made.read_m)
        known = ((as_read, "sensed"), (hills, "sensed"), (hills, "terrain_following"))
        cells = [lowest_m(top_m, ground_m, height) for ground_m, height in known]
        print(f"| {radar} | {cover} | " + " | ".join(f"{value:.1f} m" for value in cells) + " |", flush=True)
