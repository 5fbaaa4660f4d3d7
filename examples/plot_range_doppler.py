"""
Frames of chirps: range and range rate
======================================

The phase of an echo turns from chirp to chirp as its range changes. A transform over the chirps of a frame gives a map
over range rate and range, in which what moves stands apart from the ground. With SIONNA_RADAR_SMALL=1 in the
environment the ground has few scatterers.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, range_doppler

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
SIZE = {"tracing.scatterers_per_m2": 10.0} if SMALL else {}
TARGETS = [
    {"position_m": [0.0, -32.0], "waypoints_m": [[0.0, -20.0]], "speed_mps": 3.0, "rcs_dbsm": -10.0},
    {"position_m": [0.3, -27.0], "rcs_dbsm": -5.0},
]

# %%
# Beside the track of `slar` one reflector comes nearer at 3 m/s, and another one stands. At 4,000 chirps a second range
# rates are unambiguous up to 3.9 m/s, and 128 chirps tell them to 0.06 m/s.
frames = range_doppler(
    load_scenario("slar", SIZE | {"targets": TARGETS, "radar.chirp_rate_hz": 4000.0}), chirps=128, frames=8
)
print(frames)
for target in frames.targets:
    print(
        f"target {target.number}: range {target.range_m:.3f} m, found {target.found_range_m:.3f}; "
        f"range rate {target.range_rate_mps:+.4f} m/s, found {target.found_rate_mps:+.4f}"
    )

# %%
# The map of the last frame. The ground in the beam has the range rates of its directions against the flight, a band as
# wide as the beam. What lies far from it at 33 and 37 m is the ground in the skirts of the beam, 60 dB down, whose
# speckle is drawn anew in each chirp, so that it has no range rate.
last = frames.last
power_db = 10 * np.log10(last.power / last.power.max())
figure = Figure(figsize=(9, 5.4), layout="constrained")
axes = figure.subplots()
shown = axes.pcolormesh(last.range_m, last.range_rate_mps, power_db, vmin=-60, vmax=0, rasterized=True)
figure.colorbar(shown, ax=axes, label="power (dB)")
row, cell = np.nonzero(frames.detected)
ring = {"ms": 4, "color": "#e69f00", "mec": "black", "mew": 0.5, "label": "over the ring around it"}
axes.plot(last.range_m[cell], last.range_rate_mps[row], "o", **ring)
row, cell = np.nonzero(frames.changed)
axes.plot(last.range_m[cell], last.range_rate_mps[row], "+", ms=6, color="white", label="over earlier frames")
axes.set(xlabel="range (m)", ylabel="range rate (m/s)", xlim=(30, 55), title="One frame of 128 chirps")
axes.legend(loc="lower right", facecolor="0.3", labelcolor="white")
figure.savefig("range_doppler.png", dpi=110)
