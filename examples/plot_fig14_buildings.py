"""
Paper Fig. 14: buildings
========================

Boxes on flat ground, flown as the hills of Fig. 12. The error gathers at the walls, where one beam lights roof and
ground: points within half a footprint of a wall make nearly all of it.
"""

# %%
import os

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sionna_radar import load_scenario, prepare, run
from sionna_radar.accuracy import half_footprint_m, near_buildings, shadowed
from sionna_radar.report import colour_bar, empty_patch, finish_map, show_raster
from sionna_radar.scene import box_of

SMALL = "SIONNA_RADAR_SMALL" in os.environ
BLUE, RED = "#0072b2", "#d55e00"  # safe for colour-blind readers
SEEDS = (1,) if SMALL else (1, 2, 3, 4, 5)
CASTER = prepare(load_scenario("buildings")).world.caster


# %%
def truth_at(survey, place_m):
    """True height of the cell that each place lies in; NaN beyond the map."""
    grid = survey.truth.grid
    column = np.round((place_m[:, 0] - grid.west_m) / grid.spacing_m).astype(int)
    row = np.round((place_m[:, 1] - grid.south_m) / grid.spacing_m).astype(int)
    inside = (column >= 0) & (column < grid.columns) & (row >= 0) & (row < grid.rows)
    height = np.full(len(place_m), np.nan)
    height[inside] = survey.truth.height_m[row[inside], column[inside]]
    return height


def judge(survey):
    """Errors of points and cells, and which of them lie within half a footprint of a wall."""
    points, scenario = survey.points, survey.scenario
    place = points.position_m[:, :2]
    reach = half_footprint_m(points, scenario.radar.antenna.beamwidths_rad[1])
    error = points.position_m[:, 2] - truth_at(survey, place)
    boxes = [box_of(building) for building in scenario.buildings]
    point_edge = near_buildings(place, reach, boxes)
    cell = survey.truth.grid.centres_m
    # A cell has the footprint of its slant range: the distance to the radar when its beam passes.
    height = scenario.platform.altitude_m
    tilt = np.deg2rad(scenario.radar.scan.incidence_deg)
    range_m = np.hypot(cell[:, 1], height) / np.cos(tilt)
    cell_reach = range_m * scenario.radar.antenna.beamwidths_rad[1] / 2 / (height / range_m)
    cell_edge = near_buildings(cell, cell_reach, boxes).reshape(survey.truth.grid.shape)
    track = survey.schedule.trajectory.position(np.array(survey.schedule.trajectory.cruise_s()))
    hidden = shadowed(survey.truth, CASTER, track, tilt, np.deg2rad(scenario.radar.scan.half_swath_deg))
    return error, point_edge, cell_edge, hidden


def rms(values):
    """Root mean square of the known values."""
    return float(np.sqrt(np.nanmean(values**2)))


NAMES = (
    "points",
    "points, no edges",
    "cells",
    "cells, no edges",
    "cells, no edges and no radar shadow",
)
rows = []
for ranging in ("peak", "centroid"):
    for seed in SEEDS:
        survey = run(load_scenario("buildings", {"dem.method": "linear", "processing.ranging": ranging, "seed": seed}))
        error, edge, cell_edge, hidden = judge(survey)
        cells = survey.error.height_m
        kept = cells[~cell_edge & ~hidden]
        rows.append((ranging, [rms(error), rms(error[~edge]), rms(cells), rms(cells[~cell_edge]), rms(kept)]))
        shares = f"{edge.mean():.0%} of the points and {cell_edge.mean():.0%} of the cells are edges"
        if (ranging, seed) == ("peak", 1):
            shown, shown_edge = survey, cell_edge
    values = np.array([row for name, row in rows if name == ranging])
    print(f"{ranging}: {shares}; RMS over {len(SEEDS)} seeds")
    for name, mean, spread in zip(NAMES, values.mean(axis=0), values.std(axis=0), strict=True):
        print(f"    {name:44}{mean:6.2f} +- {spread:.2f} m")
peak = np.mean([row for name, row in rows if name == "peak"], axis=0)

# %%
figure = Figure(figsize=(11.5, 9.6), layout="constrained")
figure.get_layout_engine().set(wspace=0.08)
axes = figure.subplots(2, 2).ravel()
bounds = shown.truth.grid.extent_m
limits, errors = Normalize(-2, 10), Normalize(-5, 5)
for panel, raster, title in zip(axes, (shown.truth, shown.dem), ("True surface", "DEM and its points"), strict=False):
    show_raster(panel, raster, "viridis", limits)
    finish_map(panel, bounds, title)
    colour_bar(panel, ScalarMappable(limits, "viridis"), "Height (m)", 3.4, extend="both")
axes[1].plot(*shown.points.position_m[:, :2].T, ls="", marker="o", ms=1.6, mew=0, color="white", alpha=0.7)
show_raster(axes[2], shown.error, "RdBu_r", errors)
x, y = shown.truth.grid.x_m, shown.truth.grid.y_m
axes[2].contour(x, y, shown_edge, [0.5], colors="black", linewidths=0.9)
finish_map(axes[2], bounds, "DEM minus truth; outlined: half a footprint about the walls")
colour_bar(axes[2], ScalarMappable(errors, "RdBu_r"), "Height error (m)", 3.4, extend="both")

# %%
# The same as numbers: paper beside ours, with the paper's method.
place = np.arange(3)
bars = {
    "With edges": ([1.51, peak[0], peak[2]], RED),
    "Without edges; of cells, without shadow too": ([0.19, peak[1], peak[4]], BLUE),
}
for shift, (label, (values, colour)) in zip((-0.2, 0.2), bars.items(), strict=True):
    drawn = axes[3].bar(place + shift, values, 0.38, color=colour, label=label)
    axes[3].bar_label(drawn, fmt="%.2f")
axes[3].set_xticks(place, ["Paper", "Ours, points", "Ours, cells"])
axes[3].set(ylabel="RMS height error (m)")
axes[3].set_title(f"Strongest bin, {len(SEEDS)} seeds" if len(SEEDS) > 1 else "Strongest bin", fontsize="medium")
axes[3].legend(frameon=False)
axes[3].spines[["top", "right"]].set_visible(False)
axes[3].margins(y=0.25)
figure.legend(handles=[empty_patch()], loc="outside lower center", frameon=False)
figure.savefig("fig14_buildings.png", dpi=150, bbox_inches="tight")
