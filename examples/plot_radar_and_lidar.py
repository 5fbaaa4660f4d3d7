"""
Radar and lidar through the same air
====================================

The same flight with the radar and with an ideal lidar, through fog, dust, smoke and rain: error of the elevation model
and its coverage, against visibility and rain rate. The lidar has no noise and its beam no width; it misses the ground
where the air takes too much of its light, and reads the air where that returns more than its threshold. Prints the
table of LIDAR.md. With SIONNA_RADAR_SMALL=1 in the environment the flights are short ones.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, run

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
SIZE = {"platform.length_m": 3.0, "tracing.paths_per_pulse": 64, "terrain.spacing_m": 2.0} if SMALL else {}
# A real receiver's noise: with snr_db the radar would hear as well through any air.
NOISE = {"radar.snr_db": None, "radar.transmit_power_dbm": 10.0, "radar.noise_figure_db": 15.0}
LIDARS = {
    "lidar, first return": {"wavelength_nm": 905},
    "lidar, gated from 30 m": {"wavelength_nm": 905, "near_range_m": 30.0},
    "lidar 1550 nm, gated": {"wavelength_nm": 1550, "near_range_m": 30.0},
}
SENSORS = {"radar": {"sensor": "radar"}, **{name: {"sensor": "lidar", "lidar": keys} for name, keys in LIDARS.items()}}
if SMALL:
    SENSORS.pop("lidar 1550 nm, gated")
KINDS = ["fog", "rain"] if SMALL else ["fog", "dust", "smoke", "rain"]
VISIBILITIES = [100.0] if SMALL else [2000.0, 500.0, 200.0, 100.0, 50.0]
RATES = [25.0] if SMALL else [4.0, 25.0, 50.0]
AIRS = {"clear": [("", {})]}
AIRS |= {kind: [(f"{v:g} m", {f"{kind}_visibility_m": v}) for v in VISIBILITIES] for kind in KINDS if kind != "rain"}
AIRS["rain"] = [(f"{r:g} mm/h", {"rain_rate_mm_per_h": r}) for r in RATES]


def flown(sensor, weather):
    return run(load_scenario("hills", {**NOISE, **SIZE, **SENSORS[sensor], "weather": {**weather, "gases": True}}))


# %%
# RMS error of lit cells (m) and coverage. Of a lidar that reads the air, heights are off by tens of metres.
print("| air | | " + " | ".join(SENSORS) + " |")
print("|---|---|" + "---|" * len(SENSORS))
found = {}
for kind, steps in AIRS.items():
    for name, weather in steps:
        cells = []
        for sensor in SENSORS:
            lit = flown(sensor, weather).lit_error
            found[kind, name, sensor] = (lit.rms_m if lit.count else np.nan, lit.coverage)
            cells.append(f"{lit.rms_m:.3f} m, {lit.coverage:.0%}" if lit.count else "nothing")
        print(f"| {kind} | {name} | " + " | ".join(cells) + " |", flush=True)

# %%
figure = Figure(figsize=(13.0, 6.4), layout="constrained")
rows = figure.subplots(2, len(KINDS), sharex="col", sharey="row")
# Drawn from below: the lidars often agree.
LOOKS = [("#0072b2", "o", "-", 6), ("#d55e00", "s", "-", 9), ("#e69f00", "^", "--", 7), ("#009e73", "v", ":", 4)]
for column, kind in enumerate(KINDS):
    names = ["clear"] + [name for name, _ in AIRS[kind]]
    places = np.arange(len(names))
    for sensor, (colour, mark, line, size) in zip(SENSORS, LOOKS, strict=False):
        values = [found["clear", "", sensor]] + [found[kind, name, sensor] for name in names[1:]]
        style = {"color": colour, "marker": mark, "linestyle": line, "markersize": size, "label": sensor}
        rows[0, column].plot(places, [100 * coverage for _, coverage in values], **style)
        rows[1, column].plot(places, [rms for rms, _ in values], **style)
    rows[0, column].set_title(kind.capitalize())
    rows[1, column].set_xticks(places, [name.split()[0] for name in names])
    rows[1, column].set_xlabel("Rain rate (mm/h)" if kind == "rain" else "Visibility (m)")
rows[0, 0].set(ylabel="Coverage of lit cells (%)", ylim=(-5, 105))
rows[1, 0].set(ylabel="RMS error of lit cells (m)", yscale="log")
for axes in rows.ravel():
    axes.grid(alpha=0.3)
figure.legend(*rows[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(SENSORS))
figure.suptitle("Rolling hills from 50 m, ranges of 70 to 110 m: radar at 77 GHz and an ideal lidar")
figure.savefig("radar_and_lidar.png", dpi=110)
