"""
What an altimeter reads over maize
==================================

Two altimeters, at 24 GHz (`alt_24000`) and 77 GHz (`alt_77000`), fly from bare soil over a field of maize, 3 m and 10 m
above its tops, at four stages of the season and on two soils. What they read is set against the ground and the tops.
Makes the table and the picture of `docs/crops.md`. With SIONNA_RADAR_SMALL=1 one stage at one height is flown.
"""

# %%
import os
from itertools import product

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, prepare

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
RADARS = {"alt_24000": "24 GHz", "alt_77000": "77 GHz"}
STAGES = {"leaf_development": 0.35, "stem_elongation": 1.1, "flowering": 2.4, "ripe": 2.3}
CLEARANCES_M = (3.0, 10.0)
if SMALL:
    STAGES, CLEARANCES_M = {"stem_elongation": 1.1}, (3.0,)
EDGE_M, LENGTH_M, SPEED_MPS, CHIRPS, TIME_CONSTANT_S = 12.0, 36.0, 5.0, 25, 0.1
MOIST = {
    "kind": "soil", "temperature_c": 15.0, "sand_percent": 40.0, "clay_percent": 20.0, "water_fraction": 0.2,
    "specific_gravity": 2.65,
}  # fmt: skip
# A rolled seedbed, which shines straight down, and clods, which return the same to all sides.
SOILS = {
    "smooth": {"model": "kirchhoff", "medium": MOIST, "rms_height_m": 0.02, "correlation_length_m": 0.12},
    "rough": {"model": "constant_gamma", "gamma_db": -10.0},
}
FIELD_M = [[EDGE_M, -35.0], [60.0, -35.0], [60.0, 35.0], [EDGE_M, 35.0]]

# %%
# Level soil, the field from 12 m on, its rows at 20 deg to the track, and an altimeter that follows the near edge of
# 25 averaged sweeps.


def flown(radar, soil, stage, clearance_m):
    """Return the places of an altimeter's readings along the track, the readings, heights, and the echoes missing."""
    keys = {
        "terrain": {"kind": "flat", "size_m": [200.0, 160.0]},
        "materials.ground": SOILS[soil],
        "vegetation": [
            {"kind": "crop", "crop": "maize", "stage": stage, "polygon_m": FIELD_M, "row_heading_deg": 70.0}
        ],
        "platform": {
            "altitude_m": STAGES[stage] + clearance_m,
            "speed_mps": SPEED_MPS,
            "start_m": [0.0, 0.0],
            "heading_deg": 90.0,
            "length_m": LENGTH_M,
        },
        "radar": {"preset": radar},
        "tracing.speckle": "per_pulse",
        "processing": {
            "ranging": "tracker",
            "ranging_parameters": {"time_constant_s": TIME_CONSTANT_S},
            "average": {"chirps": CHIRPS, "mode": "incoherent"},
            "cfar": {"kind": "CA"},
            "volume_clutter": "off",
            "min_range_m": 1.4,
        },
        "dem": {"method": "linear", "spacing_m": 2.0},
    }
    prepared = prepare(load_scenario("hills", keys))
    index = np.arange(len(prepared))
    echoes = prepared.echoes(index)
    position_m = prepared.flight.pulses(index).true.position_m
    seen_m = position_m[echoes.pulse]
    missing = np.setdiff1d(position_m[:, 0], seen_m[:, 0])
    return seen_m[:, 0], echoes.range_m, seen_m[:, 2], missing


# %%
# Over the field, from 6 m behind its edge: reading less the height over ground and over the tops; over the soil before.
flights = {}
print("| radar | above the tops | stage | soil | less ground | less tops | spread | over soil | no echo |")
for radar, clearance_m, stage, soil in product(RADARS, CLEARANCES_M, STAGES, SOILS):
    east_m, read_m, up_m, missing = flights[radar, clearance_m, stage, soil] = flown(radar, soil, stage, clearance_m)
    over, before = east_m > EDGE_M + 6.0, (east_m > 2.0) & (east_m < EDGE_M - 6.0)
    ground_m, soil_m = (read_m - up_m)[over], (read_m - up_m)[before]
    print(
        f"| {RADARS[radar]} | {clearance_m:g} m | {stage} | {soil} | {ground_m.mean():+.2f} "
        f"| {ground_m.mean() + STAGES[stage]:+.2f} | {ground_m.std():.2f} | {soil_m.mean():+.2f} "
        f"| {len(missing) / (len(missing) + len(east_m)):.0%} |",
        flush=True,
    )

# %%
# The heights that the altimeters read along the track, at the least clearance.
figure = Figure(figsize=(9, 1.2 + 2.1 * len(STAGES)), layout="constrained")
panels = np.atleast_1d(figure.subplots(len(STAGES), 1, sharex=True))
for axes, (stage, top_m) in zip(panels, STAGES.items(), strict=True):
    axes.axhline(0.0, color="#8c510a", lw=1.5, label="ground")
    axes.plot([EDGE_M, LENGTH_M], [top_m, top_m], color="#35978f", lw=1.5, label="tops")
    for (radar, band), colour in zip(RADARS.items(), ("#0072b2", "#d55e00"), strict=True):
        for soil, line in zip(SOILS, ("-", ":"), strict=True):
            east_m, read_m, up_m, _ = flights[radar, CLEARANCES_M[0], stage, soil]
            axes.plot(east_m, up_m - read_m, line, lw=1.2, color=colour, label=f"{band}, {soil} soil")
    axes.set(ylabel="Height (m)", title=stage.replace("_", " "), xlim=(0, LENGTH_M))
figure.legend(*panels[0].get_legend_handles_labels(), frameon=False, ncols=3, loc="outside lower center")
panels[-1].set_xlabel("Along the track (m)")
figure.suptitle(f"Heights read {CLEARANCES_M[0]:g} m above the tops of maize")
figure.savefig("altimeter_crop.png", dpi=110)
