"""
Averages of several chirps
==========================

A weak radar over hills: where single chirps are lost in noise, several in a row still find the ground, their beat
signals added in phase, or their powers averaged. With SIONNA_RADAR_SMALL=1 in the environment the flight is short.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, run

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
WEAK = {"radar.snr_db": -20.0, "radar.chirp_rate_hz": 11520.0, "processing.cfar.kind": "CA"}
SIZE = {"platform.length_m": 2.0, "terrain.spacing_m": 2.0} if SMALL else {"platform.length_m": 15.0}
CHIRPS = (1, 4, 16) if SMALL else (1, 2, 4, 8, 16)

# %%
# The same flight with more and more chirps in a pulse: the pulse rate falls as their number grows.
found = {}
for mode in ("coherent", "incoherent"):
    for chirps in CHIRPS:
        average = {"processing.average.chirps": chirps, "processing.average.mode": mode} if chirps > 1 else {}
        survey = run(load_scenario("hills", WEAK | SIZE | average | {"dem.method": "linear"}))
        pulses = len(survey.prepared)
        found[mode, chirps] = (len(np.unique(survey.points.pulse)) / pulses, survey.lit_error)
        share, error = found[mode, chirps]
        print(f"{chirps:2d} {mode}: {share:.1%} of the pulses have an echo, {error.coverage:.0%} of the lit cells")

# %%
# In phase the noise falls by the number of chirps, as long as the ground in the beam turns its phase by less than a
# turn meanwhile; powers only steady the noise.
figure = Figure(figsize=(9, 3.8), layout="constrained")
left, right = figure.subplots(1, 2)
for mode, colour in (("coherent", "#0072b2"), ("incoherent", "#d55e00")):
    shares, errors = zip(*(found[mode, chirps] for chirps in CHIRPS), strict=True)
    left.plot(CHIRPS, 100 * np.array(shares), "o-", color=colour, label=mode)
    right.plot(CHIRPS, [100 * error.coverage for error in errors], "o-", color=colour, label=mode)
left.set(xlabel="Chirps of a pulse", ylabel="Pulses with an echo (%)", ylim=(0, 100))
right.set(xlabel="Chirps of a pulse", ylabel="Lit cells that the map fills (%)", ylim=(0, 100))
for axes in (left, right):
    axes.set_xscale("log", base=2)
    axes.set_xticks(CHIRPS, [str(chirps) for chirps in CHIRPS])
    axes.legend()
figure.suptitle("Hills, 20 dB below the noise of a sample")
figure.savefig("averaging.png", dpi=110)
