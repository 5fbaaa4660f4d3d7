"""
Tables of the pages on rain and weather
=======================================

The surveys behind the tables of "Maps through rain" and "What the air does to the radar", printed as rows of those
tables. With SIONNA_RADAR_SMALL=1 in the environment the flights are short and few.
"""

import os

import numpy as np

from sionna_radar import load_scenario, run

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
SIZE = {"platform.length_m": 5.0, "tracing.paths_per_pulse": 64, "terrain.spacing_m": 2.0} if SMALL else {}
SHORT = SIZE or {"platform.length_m": 60.0}
ROLLING = {"materials.ground.terrain_class": "rolling_hills"}
LINEAR, REFINED = {"dem.method": "linear"}, {"dem.method": "refined"}
SEEDS = (1,) if SMALL else (1, 2, 3, 4, 5)


def flown(scene, rate, **changes):
    """Return the survey of a scene in rain of a rate in mm/h."""
    return run(load_scenario(scene, {"weather.rain_rate_mm_per_h": float(rate), **changes}))


def errors(survey):
    """Return the errors of the lit cells that are filled, m."""
    return survey.error.height_m[survey.lit & survey.error.filled]


def range_errors(survey):
    """Return the errors of the ranges against the ground on the axis of the beam, m."""
    points = survey.points
    along = (points.position_m - points.origin_m) / points.range_m[:, None]
    return points.range_m - survey.prepared.world.caster.cast(points.origin_m, along).distance_m


# %%
# Rain over one terrain: seeds of terrain and speckle. Beside the errors of the map those of single ranges.
GROUNDS = {"rolling_hills": (0, 1, 4, 10, 25, 50), "mountain": (1, 4, 10, 25, 50), "city": (1, 4, 10, 25)}
print("| ground | mm/h | RMS (worst) | mean error | coverage over clear air's | off by > 1 m | ranges, seed 1 |")
clear = 1.0
for ground, rates in GROUNDS.items():
    for rate in rates[:2] if SMALL else rates:
        kind = {"materials.ground.terrain_class": ground, **LINEAR, **SIZE}
        surveys = [flown("hills", rate, **kind, **{"seed": seed, "terrain.seed": seed}) for seed in SEEDS]
        rms = [survey.lit_error.rms_m for survey in surveys]
        mean = np.mean([errors(survey).mean() for survey in surveys])
        coverage = np.mean([survey.lit_error.coverage for survey in surveys])
        clear = clear if rate else coverage
        off = max(np.mean(np.abs(errors(survey)) > 1) for survey in surveys)
        ranges = range_errors(surveys[0])
        print(
            f"| {ground} | {rate} | {np.mean(rms):.3f} ({max(rms):.3f}) | {mean:+.2f} | {coverage / clear:.0%} "
            f"| {off:.2%} | {ranges.std():.2f} ({ranges.mean():+.2f}) |"
        )

# %%
# Terrain of other kinds, other sweeps, other maps.
OTHERS = {
    "ridges": ("ridges", (0, 4, 10), LINEAR),
    "jacksboro": ("jacksboro", (0, 4, 10), LINEAR),
    "buildings, linear": ("buildings", (0, 4), LINEAR),
    "buildings, refined": ("buildings", (4,), REFINED),
    "hills, triangular sweep": ("hills", (0, 4), {**ROLLING, **LINEAR, "radar.sweep": "triangular"}),
    "hills, down-sweep": ("hills", (4,), {**ROLLING, **LINEAR, "radar.sweep": "down"}),
    "hills, I/Q sampling": ("hills", (4,), {**ROLLING, **LINEAR, "radar.sampling": "iq"}),
    "hills, conical scan": ("hills", (4,), {**ROLLING, **LINEAR, "radar.scan.mode": "conical"}),
}
for name, (scene, rates, changes) in OTHERS.items():
    for rate in rates[-1:] if SMALL else rates:
        survey = flown(scene, rate, seed=1, **changes, **SHORT)
        print(f"| {name} | {rate} mm/h | {survey.lit_error.rms_m:.3f} |")
for ground, rates in (("rolling_hills", (0, 1, 4, 10, 25)), ("mountain", (10,))):
    for rate in rates[-1:] if SMALL else rates:
        survey = flown("hills", rate, seed=1, **REFINED, **SIZE, **{"materials.ground.terrain_class": ground})
        off = np.mean(np.abs(errors(survey)) > 1)
        print(f"refined, {ground}, {rate} mm/h: {survey.lit_error.rms_m:.3f} m, {off:.2%} off by > 1 m")

# %%
# A survey through each air.
RAIN = {"rain_rate_mm_per_h": 4.0}
SNOW = {"snowfall_mm_per_h": 4.0}
AIRS = {
    "clear": {},
    "fog, 300 m": {"fog_visibility_m": 300.0},
    "fog, 50 m": {"fog_visibility_m": 50.0},
    "haze, 2 km": {"haze_visibility_m": 2000.0},
    "dust, 100 m": {"dust_visibility_m": 100.0},
    "dust, 10 m": {"dust_visibility_m": 10.0},
    "smoke, 100 m": {"smoke_visibility_m": 100.0},
    "dry snow, 1 mm/h": {"snowfall_mm_per_h": 1.0},
    "dry snow, 4 mm/h": SNOW,
    "wet snow, 1 mm/h": {"snowfall_mm_per_h": 1.0, "snow": "wet"},
    "wet snow, 4 mm/h": {**SNOW, "snow": "wet"},
    "rain, 4 mm/h": RAIN,
    "rain, 4 mm/h, wet radome of 0.1 m": {**RAIN, "wet_radome": {"radius_m": 0.1}},
    "rain, 4 mm/h on average, field of 50 m and 3 dB": {
        **RAIN,
        "rain_field": {"correlation_m": 50.0, "spread_db": 3.0, "seed": 1},
    },
    "shower of 25 mm/h, 30 m, in the middle of the survey": {
        "rain_cell": {"centre_m": [-50.0, 0.0], "radius_m": 30.0, "peak_mm_per_h": 25.0}
    },
    "rain, 4 mm/h, wind of 10 m/s across the track": {**RAIN, "wind_mps": [0.0, 10.0, 0.0]},
    "rain, 4 mm/h, wind of 10 m/s from behind": {**RAIN, "wind_mps": [10.0, 0.0, 0.0]},
    "rain, 4 mm/h, wind of 10 m/s from ahead": {**RAIN, "wind_mps": [-10.0, 0.0, 0.0]},
    "dry snow, 4 mm/h, wind of 10 m/s from behind": {**SNOW, "wind_mps": [10.0, 0.0, 0.0]},
}
print("| air | RMS (m) | mean (m) | coverage | off by > 1 m |")
for name, air in AIRS.items():
    survey = run(load_scenario("hills", {"seed": 1, "weather": air, **ROLLING, **LINEAR, **SIZE}))
    lit, error = survey.lit_error, errors(survey)
    off = np.mean(np.abs(error) > 1)
    print(f"| {name} | {lit.rms_m:.3f} | {error.mean():+.3f} | {lit.coverage:.1%} | {off:.2%} |")
