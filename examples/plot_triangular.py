"""
The triangular sweep: range and velocity without a navigation system
=======================================================================

Motion shifts the echo of a rising sweep one way and that of a falling one the other. The mean of both is the range,
their difference gives the range rate, without any navigation system. A sawtooth needs the velocity, and an error of
it shifts every range. With SIONNA_RADAR_SMALL=1 in the environment the flight is a short one.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario
from sionna_radar.scenario import NavigationTable
from sionna_radar.survey import Radar, observe_survey

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
SIZE = {"platform.length_m": 20.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64} if SMALL else {}
BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "0.55"  # safe for colour-blind readers
NAMES = {
    "raw": ("Sawtooth, not corrected", GREY, ":"),
    "sawtooth": ("Sawtooth, corrected by the measured velocity", BLUE, "--"),
    "triangle": ("Triangle, without a velocity", ORANGE, "-"),
}
CHANGES = {
    "raw": {"processing.doppler_correction": False},
    "sawtooth": {},
    "triangle": {"radar.sweep": "triangular"},
}

# %%
# The same hills are flown three times. What an echo should read is the range of the surface on the beam axis.
surveys = {name: observe_survey(load_scenario("hills", SIZE | changes)) for name, changes in CHANGES.items()}


def range_error_m(name):
    survey = surveys[name]
    points = survey.points(None)
    true = survey.prepared.flight.pulses(points.pulse).true
    return points.range_m - survey.prepared.world.caster.cast(true.position_m, true.boresight).distance_m


errors_m = {name: range_error_m(name) for name in surveys}
for name, error in errors_m.items():
    words = f"range {error.mean():+.3f} m, standard deviation {error.std():.3f} m; "
    print(f"{NAMES[name][0]}: {words}DEM {surveys[name].lit_error(None).rms_m:.3f} m RMS")

# %%
# The range rate of every pulse, as its pair of sweeps gives it, beside that of still ground on the beam axis.
prepared = surveys["triangle"].prepared
radar = Radar(prepared.sensor_inputs())
scan_deg, measured_mps, true_mps = [], [], []
for pulses in prepared.flight.blocks(256):
    pairs = radar.pairs(radar.tracer.trace(pulses), pulses)
    rows = np.searchsorted(pulses.index, pairs.echoes.pulse)
    scan_deg.append(np.rad2deg(pulses.scan_rad[rows]))
    measured_mps.append(pairs.range_rate_mps)
    true_mps.append(pulses.true.boresight_range_rate_mps[rows])
scan_deg, measured_mps, true_mps = (np.concatenate(column) for column in (scan_deg, measured_mps, true_mps))
off_mps = measured_mps - true_mps
print(f"range rate: {off_mps.mean():+.3f} m/s, standard deviation {off_mps.std():.3f} m/s a pulse")

# %%
# The DEM, when the navigation system's velocity along the track is wrong by a constant.
wrong_mps = np.linspace(-2.0, 2.0, 3 if SMALL else 9)


def rms_with(name, error_mps):
    survey = surveys[name]
    table = NavigationTable(velocity_constant_mps=(float(error_mps), 0.0, 0.0))
    return survey.lit_error(survey.navigation(table) if error_mps else None).rms_m


rms_m = {name: [rms_with(name, error) for error in wrong_mps] for name in surveys}

# %%
figure = Figure(figsize=(12.5, 4.4), layout="constrained")
left, middle, right = figure.subplots(1, 3)
order = np.argsort(scan_deg)
left.plot(scan_deg, measured_mps, ls="", marker="o", ms=2.5, mew=0, alpha=0.5, color=ORANGE, label="Pair of sweeps")
left.plot(scan_deg[order], true_mps[order], color="black", lw=1.4, label="Truth, on the beam axis")
reach = 1.1 * np.abs(off_mps).max()
middle_mps = float(np.median(true_mps))
left.set(xlabel="Scan angle (deg)", ylabel="Range rate (m/s)", ylim=(middle_mps - reach, middle_mps + 1.5 * reach))
left.set_title(f"Range rate of a pulse: {off_mps.std():.2f} m/s standard deviation", fontsize="medium")
left.legend(frameon=False, loc="upper center")

low = min(np.percentile(error, 0.5) for error in errors_m.values())
high = max(np.percentile(error, 99.5) for error in errors_m.values())
edges = np.linspace(low, high, 61)
for name, error in errors_m.items():
    label, colour, style = NAMES[name]
    share = 100 * np.histogram(error, bins=edges)[0] / len(error)
    middle.stairs(share, edges, color=colour, ls=style, lw=1.8, label=label)
middle.axvline(0.0, color="black", lw=0.8)
middle.set(xlabel="Range error of an echo (m)", ylabel="Share of echoes (%)")
middle.set_title("Ranges, the velocity known exactly", fontsize="medium")

for name, values in rms_m.items():
    label, colour, style = NAMES[name]
    right.plot(wrong_mps, values, color=colour, ls=style, lw=1.8, marker="o", ms=4, label=label)
right.set(xlabel="Error of the velocity along the track (m/s)", ylabel="RMS of the DEM (m)", yscale="log")
right.set_ylim(0.1, 3.0)
right.set_yticks([0.1, 0.2, 0.5, 1.0, 2.0], ["0.1", "0.2", "0.5", "1", "2"])
right.minorticks_off()
right.set_title("DEM, the velocity known less well", fontsize="medium")
for axes in (left, middle, right):
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.3)
figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
figure.savefig("triangular.png", dpi=130)
