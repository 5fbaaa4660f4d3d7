"""
Planning a flight over an area
==============================

An area of any heading is to be sampled every 3 m. The plan is made for level ground: tilt and swath that keep slopes
out of the shadow, a height that suits the beam, a speed that the antenna's rotation can follow, and lines that overlap.
Flown over steep hills it shows where they break it. With SIONNA_RADAR_SMALL=1 in the environment the area is smaller.
The same from the command line::

    sionna-radar plan --area 150x100 --sampling 3 --heading 30 --slope 45 --base hills -o plan.toml
"""

# %%
import os

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from sionna_radar import load_scenario, run
from sionna_radar import plan as plan_flight
from sionna_radar.report import colour_bar, finish_map, show_raster
from sionna_radar.studies.planning import Wanted, check_plan, planned_scenario

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
STEEP = {"terrain.filter_sigma_m": 8.0, "terrain.height_m": 34.0, "terrain.size_m": [520.0, 520.0]}
SIZE = {"terrain.spacing_m": 2.0 if SMALL else 1.0, "tracing.paths_per_pulse": 64 if SMALL else 256}
AREA = (60.0, 40.0) if SMALL else (150.0, 100.0)
# The finer the paler, and what is coarser than wanted in a colour that stands out for colour-blind readers, too.
SAMPLINGS = ListedColormap(["#eef3f8", "#b5cbe0", "#6f9cc7"]).with_extremes(over="#d55e00")
EDGE = [withStroke(linewidth=3.5, foreground="black")]

# %%
# Two plans for the same area: one that looks far to the side, and one that keeps steep slopes in sight.
base = load_scenario("hills", STEEP | SIZE)
plans, checks, scenarios = {}, {}, {}
for name, slope_deg in {"slopes up to 20 deg in sight": 20.0, "slopes up to 45 deg in sight": 45.0}.items():
    wanted = Wanted(size_m=AREA, sampling_m=3.0, heading_deg=30.0, altitude_m=50.0, greatest_slope_deg=slope_deg)
    plan = plans[name] = plan_flight(wanted, base)
    scenarios[name] = planned_scenario(plan, base)
    check = checks[name] = check_plan(plan, scenarios[name])
    print(
        f"{name}: {plan.lines} lines, {plan.flight_s:.0f} s at {plan.speed_mps:.1f} m/s; {check.coverage:.1%} sampled "
        f"as wanted, 95 % of the area every {check.sampling_of(0.95):.2f} m, coarsest {check.coarsest_m:.1f} m"
    )

# %%
# The radar flies both, and maps what it sees.
surveys = {name: run(scenario) for name, scenario in scenarios.items()}

# %%
corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * np.array(AREA) / 2
outline = next(iter(plans.values())).wanted.to_world(corners)
low, high = outline.min(axis=0) - 8.0, outline.max(axis=0) + 8.0
bounds = (low[0], high[0], low[1], high[1])
truths = [survey.truth.height_m[survey.truth.filled] for survey in surveys.values()]
heights = Normalize(min(map(np.min, truths)), max(map(np.max, truths)))
steps = BoundaryNorm([0.0, 1.0, 2.0, 3.0], SAMPLINGS.N)
WIDTH_IN = 4.0

figure = Figure(figsize=(10.6, 9.6), layout="constrained")
for row, name in zip(figure.subplots(2, 2), plans, strict=True):
    plan, check, survey = plans[name], checks[name], surveys[name]
    found = survey.lit_error
    show_raster(row[0], survey.dem, "viridis", heights)
    row[0].plot(*np.array(plan.waypoints_m).T, color="white", lw=1.6, path_effects=EDGE, label="Planned flight")
    inside = row[1].pcolormesh(
        check.place_m[..., 0], check.place_m[..., 1], check.sampling_m, cmap=SAMPLINGS, norm=steps, shading="nearest"
    )
    for axes in row:
        axes.plot(*outline.T, color="black", lw=1.6, ls="--", label="Area wanted")
    finish_map(
        row[0],
        bounds,
        f"{plan.lines} lines, {name}\nDEM, RMS error {found.rms_m:.2f} m, {found.coverage:.0%} of lit cells",
    )
    share = f"{check.coverage:.1%} of the area at 3 m or finer"
    finish_map(row[1], bounds, f"Sampling by the beam axes\n{share}, coarsest {check.coarsest_m:.1f} m")
    row[1].set_ylabel("")
    colour_bar(row[0], ScalarMappable(heights, "viridis"), "Height (m)", WIDTH_IN)
    colour_bar(row[1], inside, "Sampling (m)", WIDTH_IN, extend="max")
handles, labels = figure.axes[0].get_legend_handles_labels()
figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
figure.savefig("plan.png", dpi=120, bbox_inches="tight")
