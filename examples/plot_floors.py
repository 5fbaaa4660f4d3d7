"""
Floors under a weak echo
========================

What sets the floor under ground at 75 deg of incidence: a radar with the phase noise of a published chip, a transmitter
that leaks between its antennas and off its radome, a 12-bit converter and rain. Every floor is a closed form; the grey
line is the mean spectrum of pulses that were traced, synthesised and converted. Below, how far ground is detected.
With SIONNA_RADAR_SMALL=1 in the environment fewer pulses are flown.
"""

# %%
import os

from sionna_radar import link_budget, load_scenario
from sionna_radar.studies.link import draw_floors, draw_link

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
RADAR = {
    "radar.transmit_power_dbm": 12.0,
    "radar.noise_figure_db": 14.0,
    "radar.chirp_rate_hz": 8000.0,
    "radar.scan.incidence_deg": 75.0,
    "radar.scan.half_swath_deg": 20.0,
    "radar.receiver.high_pass_corner_hz": 200e3,
    "radar.receiver.oscillator.phase_noise_preset": "ti_awr1843aop_76ghz",
    "radar.receiver.leakage": [{"delay_ns": 0.51, "level_db": -35.0}, {"delay_ns": 1.23, "level_db": -45.0}],
    "radar.receiver.converter.bits": 12,
    "radar.receiver.converter.full_scale_dbm": -22.0,
    "weather.rain_rate_mm_per_h": 4.0,
    "platform.altitude_m": 20.0,
    "platform.length_m": 5.0,
}
if SMALL:
    RADAR |= {"tracing.paths_per_pulse": 64, "terrain.spacing_m": 2.0}
budget = link_budget(
    load_scenario("rain", RADAR),
    incidences_deg=[75.0] if SMALL else [45.0, 60.0, 75.0],
    rains_mm_per_h=[4.0] if SMALL else [0.0, 4.0],
    pulses=100 if SMALL else 3000,
)

# %%
# Where each floor is the highest, and where simulation and closed form meet.
for name, start, end in budget.floors.rulers():
    print(f"from {start:.1f} to {end:.1f} m: {name}")
print(f"closed form and simulation are at most {budget.largest_difference_db:.2f} dB apart")
figure = draw_floors(budget)
figure.savefig("floors.png", dpi=110)

# %%
# Signal to noise, and how probably one range cell of the ground is detected.
for one in budget.links:
    case = f"{one.incidence_deg:g} deg, {one.rain_mm_per_h:g} mm/h"
    print(f"{case}: one range cell finds the ground up to {one.cell_reach_m:.0f} m")
figure = draw_link(budget)
figure.savefig("link.png", dpi=110)
