"""
Why one flies a radar
=====================

The same houses from the same place: what a camera sees of them in clear air, in fog, in a brownout and by starlight,
and the maps that a radar and a lidar make of them in that brownout. Fog and dust take the contrast of the ground as
Koschmieder's law has it, and at night a pixel counts fewer electrons than its read-out is noisy by. Prints the contrast
of the ground beside the noise of a pixel, and the errors of the maps. With SIONNA_RADAR_SMALL=1 in the environment the
flights are short ones.
"""

# %%
import os

from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sionna_radar import camera, load_scenario, run
from sionna_radar.report import colour_bar, finish_map, show_raster

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
LENS = {
    "camera.frames": 1,
    "camera.pixels": [280, 210],
    "camera.depression_deg": 27.0,
    "camera.field_of_view_deg": 50.0,
}
DUST = {"weather.dust_visibility_m": 30.0}
LIGHTS = {
    "Clear air": {},
    "Fog, visibility 150 m": {"weather.fog_visibility_m": 150.0},
    "Brownout, visibility 30 m": DUST,
    "Starlight, clear air": {"camera.night": True},
}
# Absolute powers: with snr_db the radar would hear as well through any air.
RADAR = {"radar.snr_db": None, "radar.transmit_power_dbm": 10.0, "radar.noise_figure_db": 15.0}
SENSORS = {
    "Radar": {**RADAR, "dem.method": "linear" if SMALL else "stepped"},
    "Lidar": {"sensor": "lidar", "lidar.wavelength_nm": 905, "lidar.near_range_m": 30.0},
}
LENGTH = {"platform.length_m": 5.0} if SMALL else {}

# %%
# Frames from the first place of the flight.
frames = {}
for name, keys in LIGHTS.items():
    frame = frames[name] = camera(load_scenario("buildings", {**LENGTH, **LENS, **keys})).frames[0]
    print(f"{name}: contrast {frame.contrast:.2g}, noise {frame.noise:.2g}")

# %%
# Maps of the same houses in the brownout. "stepped" warns of whatever hangs in the air: the echo of rain may pass for
# roofs. That of dust at 77 GHz is too weak for it.
surveys = {name: run(load_scenario("buildings", {**LENGTH, **DUST, **keys})) for name, keys in SENSORS.items()}
for name, survey in surveys.items():
    lit = survey.lit_error
    print(f"{name}: {lit.coverage:.0%} of the lit cells" + (f", {lit.rms_m:.3f} m RMS" if lit.count else ""))

# %%
figure = Figure(figsize=(13.0, 7.4), layout="constrained")
above, below = figure.subfigures(2, 1, height_ratios=[2.9, 4.5])
for axes, (name, frame) in zip(above.subplots(1, len(frames)), frames.items(), strict=True):
    axes.imshow(frame.image, cmap="gray", vmin=0, vmax=255)
    axes.set(xticks=[], yticks=[], title=name)
scale = Normalize(0.0, 10.0)
for axes, (name, survey) in zip(below.subplots(1, len(surveys)), surveys.items(), strict=True):
    show_raster(axes, survey.dem, "viridis", scale)
    title = f"{name} in the brownout: {survey.lit_error.coverage:.0%} of the lit cells"
    finish_map(axes, survey.dem.grid.extent_m, title)
    colour_bar(axes, ScalarMappable(scale, "viridis"), "Height (m)", 4.5)
figure.savefig("why_radar.png", dpi=90)
