"""
How good the GPS/IMU must be
============================

The survey is flown once and its echoes kept; each error of navigation only moves where they are placed. The RMS of
the DEM stays flat while an error is small, then rises: the knee is what the GPS/IMU must keep to. The same scan with
an ideal range sensor, a lidar, shows how much of the error at rest is the radar beam's.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, run
from sionna_radar.scenario import NavigationTable
from sionna_radar.survey import observe_survey

small = os.environ.get("SIONNA_RADAR_SMALL") == "1"
size = {"platform.length_m": 12.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64} if small else {}
steps, draws = (3, 1) if small else (9, 4)
scenario = load_scenario("hills", size)
survey = observe_survey(scenario)
exact = survey.lit_error(None).rms_m
lidar = run(scenario.model_copy(update={"sensor": "lidar"})).lit_error.rms_m
print(f"exact pose: radar {exact:.3f} m, lidar {lidar:.3f} m RMS")


# %%
def rms(key: str, axes: tuple[float, float, float], size: float) -> float:
    """Return the RMS of the DEM with one error, the mean square over some draws of the random ones."""
    table = NavigationTable.model_validate({key: tuple(size * share for share in axes)})
    squares = [survey.lit_error(survey.navigation(table, seed)).rms_m ** 2 for seed in range(draws)]
    return float(np.sqrt(np.mean(squares)))


ACROSS, UP, EACH = (1.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0)
PANELS = {
    "Position (m)": {"east and north": ("position_{}_m", ACROSS), "up": ("position_{}_m", UP)},
    "Velocity (m/s)": {"every axis": ("velocity_{}_mps", EACH)},
    "Attitude (deg)": {
        "roll": ("attitude_{}_deg", (1.0, 0.0, 0.0)),
        "pitch": ("attitude_{}_deg", (0.0, 1.0, 0.0)),
        "heading": ("attitude_{}_deg", (0.0, 0.0, 1.0)),
    },
}
COLOURS = ("#0072b2", "#e69f00", "#d55e00")
STYLES = {"white": "-", "markov": "--"}

# %%
figure = Figure(figsize=(11, 4), layout="constrained")
for axes, (title, errors) in zip(figure.subplots(1, 3, sharey=True), PANELS.items(), strict=True):
    sizes = np.geomspace(0.01, 3.0, steps)
    for colour, (name, (key, shares)) in zip(COLOURS, errors.items(), strict=False):
        for kind, style in STYLES.items():
            grown = [rms(key.format(kind), shares, s) for s in sizes]
            label = f"{name}, {'white' if kind == 'white' else 'Gauss-Markov'}"
            axes.loglog(sizes, grown, style, color=colour, label=label)
    axes.axhline(exact, color="0.5", lw=1)
    axes.axhline(lidar, color="0.5", lw=1, ls=":")
    axes.axhline(1.1 * exact, color="black", lw=1, ls="-.")
    axes.set(xlabel=title, ylabel="RMS of the DEM (m)" if "Position" in title else "")
    axes.legend(frameon=False, fontsize="small", loc="upper left")
    axes.text(0.011, exact * 0.97, "radar, exact pose", fontsize="small", color="0.4", va="top")
    axes.text(0.011, lidar * 1.03, "lidar, exact pose", fontsize="small", color="0.4", va="bottom")
figure.suptitle("Error of the DEM against standard deviations of the measured pose (dash-dotted: 10 % more)")
figure.savefig("navigation.png", dpi=120)
