"""
A flight that corrects its own navigation
=========================================

Lines that cross see the same ground from two sides, and must agree on it. With ``processing.navigation = "refined"``
the errors of an inertial system are estimated together with the ground, from the echoes alone: roll and pitch come out
well, since they tilt the ground of one line against that of another; a constant error of the place cannot, since all
the map moves with it.
"""

# %%
import os

from sionna_radar import load_scenario, run
from sionna_radar.report import draw_navigation

small = os.environ.get("SIONNA_RADAR_SMALL") == "1"
flight = {
    "platform.lines": {"count": 2, "spacing_m": 20.0, "length_m": 30.0 if small else 80.0, "crossing": True},
    "platform.start_m": None,
    "platform.navigation.position_markov_m": 0.03,
    "platform.navigation.attitude_markov_deg": [0.1, 0.1, 0.2],
    "platform.navigation.boresight_error_deg": [0.2, 0.0, 0.0],
    **({"radar.antenna.beamwidth_deg": 4.0, "radar.chirp_rate_hz": 120.0, "dem.spacing_m": 4.0} if small else {}),
}
reported = run(load_scenario("hills", flight))
refined = run(load_scenario("hills", flight | {"processing.navigation": "refined"}))
exact = run(load_scenario("hills", flight | {"platform.navigation": {}}))
for name, survey in (("exact", exact), ("reported", reported), ("refined", refined)):
    print(f"{name} poses: {survey.lit_error.rms_m:.3f} m RMS")

# %%
# Truth, estimate and its interval of 95 % over time; grey is what was known beforehand.
figure = draw_navigation(refined)
figure.savefig("refined_navigation.png", dpi=120)
