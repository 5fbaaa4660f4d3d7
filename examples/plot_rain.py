"""
Maps through rain
=================

Rain fills the beam with an echo of its own, which is the strongest there is a few metres in front of the antenna and
hides weak ground. The processing knows nothing of it beforehand: it finds the rain's mean echo, which is the same in
every pulse, and in each pulse the ground: by its own echo, and because behind the ground there is no rain. An ideal
lidar flies the same way through the same rain. With SIONNA_RADAR_SMALL=1 in the environment the flights are short ones.
"""

# %%
import os

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sionna_radar import load_scenario, prepare, run
from sionna_radar.report import colour_bar, empty_patch, finish_map, show_raster

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
RATES = [0.0, 10.0] if SMALL else [0.0, 4.0, 10.0, 25.0]
SIZE = {"platform.length_m": 5.0, "tracing.paths_per_pulse": 64, "terrain.spacing_m": 2.0} if SMALL else {}
LIDAR = {"sensor": "lidar", "lidar.wavelength_nm": 905}
GROUND = {"materials.ground.terrain_class": "rolling_hills"}  # 7 dB weaker than the scene's own


def in_rain(rate, **changes):
    return load_scenario("rain", {"weather.rain_rate_mm_per_h": rate, **GROUND, **SIZE, **changes})


# %%
# What the beam hears in one turn of the antenna: power times range squared, and where the ground is found in it.
def one_turn(scenario):
    prepared = prepare(scenario)
    sensor = prepared.build_sensor()
    turns = list(prepared.flight.line_blocks(1))
    pulses = turns[len(turns) // 2]
    analyser = prepared.instrument.detector.analyser
    power = analyser.power(prepared.receiver.beat(sensor.tracer.trace(pulses), pulses))
    echoes = sensor.observe(pulses).echoes
    where = np.searchsorted(pulses.index, echoes.pulse)
    level_db = 10 * np.log10(np.maximum(power * analyser.range_m**2, 1e-30) / prepared.receiver.transmit_power_w)
    return np.rad2deg(pulses.scan_rad), analyser.range_m, level_db, where, echoes.range_m


def draw_turn(axes, scenario, title):
    scan_deg, range_m, level_db, where, found_m = one_turn(scenario)
    image = axes.pcolormesh(scan_deg, range_m, level_db.T, cmap="magma", vmin=-125, vmax=-60, shading="nearest")
    axes.plot(scan_deg[where], found_m, ".", color="#56b4e9", markersize=3.5, label="ground found")
    axes.set(ylim=(120, 0), xlabel="Scan angle (deg)", title=title)
    return image


figure = Figure(figsize=(3.7 * len(RATES) + 1.2, 12.0), layout="constrained")
rows = figure.subplots(4, len(RATES))
heights, errors = Normalize(-1.0, 9.0), Normalize(-1.0, 1.0)
for column, rate in enumerate(RATES):
    name = f"Rain of {rate:g} mm/h" if rate else "Clear air"
    image = draw_turn(rows[0, column], in_rain(rate), name)
    survey = run(in_rain(rate))
    lit = survey.lit_error
    off = np.abs(survey.error.height_m[survey.lit & survey.dem.filled])
    print(
        f"{name}: RMS {lit.rms_m:.3f} m over {lit.coverage:.1%} of the lit cells, {np.mean(off > 1):.2%} of them off "
        f"by more than 1 m; {len(survey.points)} of {survey.pulses} pulses find the ground"
    )
    show_raster(rows[1, column], survey.dem, "viridis", heights)
    finish_map(rows[1, column], survey.truth.grid.extent_m, "The map")
    show_raster(rows[2, column], survey.error, "RdBu_r", errors)
    said = f"Its error: RMS {lit.rms_m:.2f} m, {lit.coverage:.0%} covered"
    finish_map(rows[2, column], survey.truth.grid.extent_m, said)
    light = run(in_rain(rate, **LIDAR))
    seen = light.lit_error
    print(f"    ideal lidar at 905 nm: RMS {seen.rms_m:.3f} m over {seen.coverage:.1%} of the lit cells")
    show_raster(rows[3, column], light.error, "RdBu_r", errors)
    said = f"Ideal lidar: RMS {seen.rms_m:.2f} m, {seen.coverage:.0%} covered"
    finish_map(rows[3, column], light.truth.grid.extent_m, said)
    for axes in rows[:, column] if column else ():
        axes.set_ylabel("")
rows[0, 0].set_ylabel("Range (m)")
rows[0, 0].legend(loc="upper left", fontsize="small", labelcolor="linecolor", framealpha=0.3)
colour_bar(rows[0, -1], image, "Power times range squared (dB m²)", 2.6, extend="both")
colour_bar(rows[1, -1], ScalarMappable(heights, "viridis"), "Height (m)", 2.6)
for row in rows[2:]:
    colour_bar(row[-1], ScalarMappable(errors, "RdBu_r"), "DEM minus truth (m)", 2.6, extend="both")
figure.legend(handles=[empty_patch()], loc="outside lower center", frameon=False)
figure.suptitle("Rolling hills from 50 m, 2 deg beam at 77 GHz: what one turn of the beam hears, and the map")

# %%
# The same flight without looking for the rain.
blind = run(in_rain(RATES[-1], **{"processing.volume_clutter": "off"}))
lit = blind.lit_error
print(f"{RATES[-1]:g} mm/h, processing.volume_clutter = 'off': RMS {lit.rms_m:.1f} m, {lit.coverage:.0%} covered")
figure.savefig("rain.png", dpi=110, bbox_inches="tight")
