"""
Paper Table 3: error against beamwidth
======================================

The survey of Fig. 12 with beams of 1, 2, 4 and 8 deg, several seeds each, beside the paper's numbers. The same from
the command line, with a table and all runs as CSV::

    sionna-radar sweep hills --vary radar.antenna.beamwidth_deg=1,2,4,8 --vary processing.ranging=peak,centroid \
        --repeat 5 -o results/table3
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar.studies.sweep import Axis, label, plan_sweep, run_sweep

SMALL = "SIONNA_RADAR_SMALL" in os.environ
COLOURS = {"peak": "#0072b2", "centroid": "#d55e00"}  # safe for colour-blind readers
NAMES = {"peak": "Strongest bin (the paper's method)", "centroid": "Centroid of power"}
PAPER = {  # beam (deg): min, max, std, mean, RMS (m)
    1.0: (-1.24, 1.04, 0.18, -0.12, 0.22),
    2.0: (-2.65, 2.24, 0.25, -0.15, 0.29),
    4.0: (-6.52, 5.19, 0.64, -0.24, 0.69),
    8.0: (-16.28, 10.73, 1.93, -0.66, 2.04),
}
COLUMNS = ("min_m", "max_m", "std_m", "mean_m", "rms_m")

# %%
beams = (2.0, 4.0) if SMALL else tuple(PAPER)
axes = (
    Axis(key="processing.ranging", values=tuple(NAMES)),
    Axis(key="radar.antenna.beamwidth_deg", values=beams),
)
shorter = {"platform.length_m": 12.0, "tracing.paths_per_pulse": 64, "terrain.spacing_m": 2.0} if SMALL else {}
sweep = run_sweep(plan_sweep("hills", axes, repeat=2 if SMALL else 5, overrides=shorter))

# %%
print(f"{'':44}{'min':>8}{'max':>8}{'std':>8}{'mean':>8}{'RMS':>8}{'coverage':>10}")
for beam in beams:
    print(f"{f'paper, {beam:g} deg':44}" + "".join(f"{value:8.2f}" for value in PAPER[beam]))
    for case in sweep.cases:
        if case.setting["radar.antenna.beamwidth_deg"] == beam:
            values = "".join(f"{case.mean(column):8.2f}" for column in COLUMNS)
            print(f"{label(case.setting):44}{values}{case.mean('coverage'):10.1%}")

# %%
figure = Figure(figsize=(11.5, 4.4), layout="constrained")
panels = {"rms_m": (4, "RMS error (m)"), "mean_m": (3, "Mean error (m)"), "std_m": (2, "Standard deviation (m)")}
for panel, (statistic, (column, name)) in zip(figure.subplots(1, 3), panels.items(), strict=True):
    paper = [PAPER[beam][column] for beam in beams]
    panel.plot(beams, paper, color="black", ls="--", lw=1.4, marker="D", ms=6, mfc="white", label="Paper, Table 3")
    for ranging, colour in COLOURS.items():
        cases = [case for case in sweep.cases if case.setting["processing.ranging"] == ranging]
        mean, spread = [case.mean(statistic) for case in cases], [case.spread(statistic) for case in cases]
        panel.errorbar(beams, mean, spread, color=colour, lw=1.4, marker="o", ms=6, capsize=4, label=NAMES[ranging])
    panel.set_xscale("log", base=2)
    panel.set_xticks(beams, [f"{beam:g}" for beam in beams])
    if statistic != "mean_m":
        panel.set_yscale("log")
        ticks = np.array([0.05, 0.1, 0.2, 0.5, 1.0, 2.0])
        panel.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        panel.set_ylim(0.06, 2.8)
        panel.minorticks_off()
    else:
        panel.axhline(0.0, color="0.5", lw=0.8)
    panel.set(xlabel="Half-power beamwidth (deg)", ylabel=name)
    panel.grid(alpha=0.3)
    panel.spines[["top", "right"]].set_visible(False)
handles = figure.axes[0].get_legend_handles_labels()
figure.legend(*handles, loc="outside lower center", ncols=3, frameon=False)
figure.suptitle(f"Hills from 50 m; bars: standard deviation over {sweep.repeat} seeds", fontsize="medium")
figure.savefig("table3_beamwidth.png", dpi=150, bbox_inches="tight")
