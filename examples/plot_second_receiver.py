"""
A second receiver: a wide beam's echo becomes a profile
=======================================================

An 8 deg beam lights 14 m of ground, and a radar with one receiver places its echo on the beam's axis. The phase between
receivers a wavelength apart tells where in the beam each range cell is: every pulse gives points along the ground. A
whisk-broom turns the range cells across the beam, so that it takes one receiver more for each axis. With
SIONNA_RADAR_SMALL=1 in the environment the flight is a short one.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, run

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
SIZE = {"platform.length_m": 15.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 128} if SMALL else {}
WIDE = SIZE | {"radar.antenna.beamwidth_deg": 8.0}
BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "0.55"  # safe for colour-blind readers

# %%
# The same hills, with one receiver and with three.
one = run(load_scenario("hills", WIDE))
three = run(
    load_scenario("hills", WIDE | {"processing.angle": "interferometric", "radar.second_receiver.axis": "both"})
)
for name, survey in (("one receiver", one), ("three receivers", three)):
    lit = survey.lit_error
    print(f"{name}: {len(survey.points):,} points, RMS {lit.rms_m:.3f} m, coverage {lit.coverage:.1%}")


# %%
# How far each point lies above or below the ground, against the scan angle of its pulse.
def off_ground_m(survey):
    position = survey.points.position_m
    above = np.column_stack([position[:, :2], np.full(len(position), 100.0)])
    down = np.tile([[0.0, 0.0, -1.0]], (len(position), 1))
    return position[:, 2] - 100.0 + survey.prepared.world.caster.cast(above, down).distance_m


def scan_deg(survey):
    return np.rad2deg(survey.prepared.flight.pulses(survey.points.pulse).scan_rad)


figure = Figure(figsize=(11, 7), layout="constrained")
top, *maps = figure.subplot_mosaic([["points", "points"], ["one", "three"]]).values()
for survey, color, name in ((one, ORANGE, "one receiver"), (three, BLUE, "three receivers")):
    top.plot(scan_deg(survey), off_ground_m(survey), ".", color=color, ms=3, label=name)
top.axhline(0.0, color=GREY, lw=1)
top.set(xlabel="scan angle (deg)", ylabel="points above the ground (m)", ylim=(-2, 2))
top.legend()
for axes, survey, name in zip(maps, (one, three), ("one receiver", "three receivers"), strict=True):
    extent = survey.error.grid.extent_m
    error = np.where(survey.lit, survey.error.height_m, np.nan)
    shown = axes.imshow(error, extent=extent, origin="lower", cmap="RdBu_r", vmin=-0.6, vmax=0.6)
    axes.set(xlabel="east (m)", ylabel="north (m)", title=f"{name}: {survey.lit_error.rms_m:.3f} m RMS")
figure.colorbar(shown, ax=maps, label="error of lit cells (m)")
figure.savefig("second_receiver.png", dpi=110)
