"""
Paper Fig. 12: hilly ground
===========================

From 50 m, at 45 deg, scanned to 50 deg on either side, with the pose known exactly and Doppler corrected: the true
surface, the DEM with the points that made it, and their difference. The paper's method (the strongest bin) gives
its error, 0.29 m. The lower row flies over steeper hills, which throw radar shadows.
"""

# %%
import os

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from sionna_radar import load_scenario, run
from sionna_radar.accuracy import shadowed
from sionna_radar.report import colour_bar, empty_patch, finish_map, show_raster

SMALL = "SIONNA_RADAR_SMALL" in os.environ
METHOD = {"processing.ranging": "peak", "platform.length_m": 8.0 if SMALL else 100.0}
STEEPER = {"terrain.filter_sigma_m": 12.0, "terrain.height_m": 30.0}
SHADOW = ListedColormap(["#cc79a7"])


# %%
def hidden(survey):
    """Cells that the scan passes over without seeing them."""
    scenario, caster = survey.scenario, survey.prepared.world.caster
    track = survey.schedule.trajectory.position(np.array(survey.schedule.trajectory.cruise_s()))
    angles = np.deg2rad([scenario.radar.scan.incidence_deg, scenario.radar.scan.half_swath_deg])
    return shadowed(survey.truth, caster, track, *angles)


surveys = [run(load_scenario("hills", METHOD)), run(load_scenario("hills", METHOD | STEEPER))]
figure = Figure(figsize=(14.5, 8.0), layout="constrained")
rows = figure.subplots(2, 3)
for axes, survey, name in zip(rows, surveys, ("Hills", "Steeper hills"), strict=True):
    bounds = survey.truth.grid.extent_m
    heights = np.concatenate([survey.truth.height_m[survey.truth.filled], survey.dem.height_m[survey.dem.filled]])
    limits = Normalize(heights.min(), heights.max())  # one scale for truth and estimate
    shadow = hidden(survey)
    reach = 1.0 if name == "Hills" else 2.0
    width_in = 2.3
    track = survey.schedule.trajectory.position(np.linspace(0, survey.schedule.trajectory.end_s, 50))
    show_raster(axes[0], survey.truth, "viridis", limits)
    axes[0].plot(track[:, 0], track[:, 1], color="black", lw=1.5)
    finish_map(axes[0], bounds, f"{name}: true surface")
    show_raster(axes[1], survey.dem, "viridis", limits)
    axes[1].plot(*survey.points.position_m[:, :2].T, ls="", marker="o", ms=1.6, mew=0, color="white", alpha=0.8)
    finish_map(axes[1], bounds, f"{name}: DEM and its {len(survey.points):,} points")
    show_raster(axes[2], survey.error, "RdBu_r", Normalize(-reach, reach))
    finish_map(axes[2], bounds, f"{name}: DEM minus truth, RMS {survey.lit_error.rms_m:.2f} m")
    for one in axes:
        one.imshow(np.ma.masked_equal(shadow, 0), origin="lower", extent=bounds, cmap=SHADOW, interpolation="nearest")
    for one in axes[1:]:
        one.set_ylabel("")
    for one in axes[:2]:
        colour_bar(one, ScalarMappable(limits, "viridis"), "Height (m)", width_in)
    colour_bar(axes[2], ScalarMappable(Normalize(-reach, reach), "RdBu_r"), "Height error (m)", width_in, extend="both")
    error = survey.lit_error
    mapped = survey.dem.filled[shadow].mean() if shadow.any() else 0.0
    print(
        f"{name}: RMS {error.rms_m:.3f} m, mean {error.mean_m:+.3f} m, NMAD {error.nmad_m:.3f} m, coverage "
        f"{error.coverage:.1%}; {shadow.sum()} cells in shadow, {mapped:.0%} of them interpolated across"
    )
handles = [Patch(facecolor="#cc79a7", edgecolor="0.4", label="Radar shadow, by geometry"), empty_patch()]
figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
figure.savefig("fig12_hills.png", dpi=150, bbox_inches="tight")
