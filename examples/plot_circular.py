"""
Circular polarization against rain
==================================

A sphere returns a circular wave in the opposite sense alone. A radar that receives the sense it sends hears little of
the rain, whose drops are nearly round, and loses part of the ground. What that buys and costs over three grounds, as
signal to rain and as maps; the table is that of CIRCULAR.md. With SIONNA_RADAR_SMALL=1 in the environment the flights
are short ones.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, prepare, run
from sionna_radar.tracing import VOLUME
from sionna_radar.weather import drop_polarization, marshall_palmer

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
GROUNDS = ["mountain"] if SMALL else ["rolling_hills", "mountain", "city"]
RATES = [25.0] if SMALL else [4.0, 25.0]
SIZE = {"platform.length_m": 3.0, "tracing.paths_per_pulse": 64, "terrain.spacing_m": 2.0} if SMALL else {}
NOISE = {"radar.snr_db": None, "radar.transmit_power_dbm": 10.0, "radar.noise_figure_db": 15.0}
ANTENNAS = {
    "V, co": {"polarization": "V"},
    "RHCP, same sense": {"polarization": "RHCP"},
    "the same, axial ratio 1 dB": {"polarization": "RHCP", "axial_ratio_db": 1.0},
}
if SMALL:
    ANTENNAS.pop("RHCP, same sense")


def in_rain(ground, rate, antenna):
    changes = {"materials.ground.terrain_class": ground, "weather.rain_rate_mm_per_h": rate}
    antenna = {"beamwidth_deg": 2.0, **antenna}
    return load_scenario("hills", {**NOISE, **SIZE, **changes, "radar.antenna": antenna})


# %%
# Received power of ground and rain, means over pulses spread over the survey. The rain is that from half the range of
# the ground on, so that the few metres in front of the antenna do not rule the number.
def levels_db(scenario):
    prepared = prepare(scenario)
    pulses = prepared.flight.sample(30 if SMALL else 300)
    paths = prepared.build_sensor().tracer.trace(pulses)
    power, rain = np.abs(paths.gain.astype(complex)) ** 2, paths.surface == VOLUME
    far = paths.delay_s > 0.5 * np.median(paths.delay_s[~rain])
    return 10 * np.log10(power[~rain].sum() / len(pulses)), 10 * np.log10(power[rain & far].sum() / len(pulses))


print("| ground | mm/h | antenna | ground, dB | rain, dB | signal to rain, dB | RMS of lit cells, m | coverage |")
print("|---|---|---|---|---|---|---|---|")
for ground in GROUNDS:
    for rate in RATES:
        reference = None
        for name, antenna in ANTENNAS.items():
            scenario = in_rain(ground, rate, antenna)
            echo, clutter = levels_db(scenario)
            reference = reference or (echo, clutter)
            lit = run(scenario).lit_error
            print(
                f"| {ground} | {rate:g} | {name} | {echo - reference[0]:+.1f} | {clutter - reference[1]:+.1f} | "
                f"{echo - clutter:.1f} | {lit.rms_m:.3f} | {lit.coverage:.1%} |",
                flush=True,
            )

# %%
# The same-sense echo of rain over the opposite one, by the angle between the line of sight and the vertical.
angle = np.linspace(1.0, 90.0, 45)
right = np.tile(np.array([1.0, 1j]) / np.sqrt(2), (len(angle), 1))
figure = Figure(figsize=(6.4, 4.2), layout="constrained")
axes = figure.subplots()
for rate in (1.0, 4.0, 25.0, 50.0):
    rain = drop_polarization(77e9, marshall_palmer(rate), 288.15)
    level_db = 10 * np.log10(rain.power(np.deg2rad(angle), right, right))
    axes.plot(angle, level_db, label=f"{rate:g} mm/h, perfect antenna")
for ratio_db in (0.5, 1.0, 3.0):
    r2 = 10 ** (ratio_db / 10)
    axes.axhline(20 * np.log10((r2 - 1) / (r2 + 1)), color="grey", linestyle=":")
    axes.annotate(f"axial ratio {ratio_db:g} dB", (2, 20 * np.log10((r2 - 1) / (r2 + 1)) + 0.6), fontsize="small")
axes.set(xlabel="Angle from the vertical (deg)", ylabel="Same over opposite sense (dB)", ylim=(-70, 0))
axes.legend(fontsize="small", loc="lower right")
axes.set_title("Rain in a circular radar at 77 GHz")
figure.savefig("circular.png", dpi=110)
