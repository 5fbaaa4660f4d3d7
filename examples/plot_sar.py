"""
Side-looking radar: the image of the real aperture, and the focused one
=======================================================================

A fan beam looks to the right of a straight track over two fields, a building and three reflectors. Laid side by side,
its range-compressed pulses make the image of a side-looking radar (SLAR), as fine along the track as the beam is
wide. Back-projection (SAR) focuses the same pulses to about half the antenna's length.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.imaging.aperture import whole_beam
from sionna_radar.imaging.grid import ground_pixels
from sionna_radar.imaging.resolution import azimuth_resolution_m, ground_range_resolution_m, half_power_width
from sionna_radar.imaging.sar import BackProjection
from sionna_radar.imaging.slar import SideLooking, to_ground
from sionna_radar.preparation import prepare
from sionna_radar.survey import build_tracer, received

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
WINDOW = "hann"
overrides = {}
if SMALL:
    overrides = {"platform.length_m": 6.0, "platform.start_m": [-2.0, 0.0], "tracing.scatterers_per_m2": 10.0}
scenario = load_scenario("slar", overrides)

# %%
# The survey: what the radar receives, block by block, with the measured poses of its pulses.
ready = prepare(scenario)
tracer = build_tracer(ready)
track = ready.schedule.sample(2).measured
start_east = track.position_m[0, 0]
length = track.position_m[1, 0] - start_east

# %%
# Both images grow from the same pulses. The ends of the track are left out: their aperture is not flown whole.
margin = 2.0
aperture = whole_beam(ready.antenna)
step = 0.04 if SMALL else 0.02
pixels = ground_pixels(
    track, "right", 0.0, np.arange(margin, length - margin, step), np.arange(22.0, 35.0, 0.3 if SMALL else 0.15)
)
slar = SideLooking(SpectrumAnalyser(ready.chirp, WINDOW, 4), step_m=0.1)
sar = BackProjection(ready.chirp, pixels, aperture, WINDOW)
for pulses in ready.schedule.blocks(64):
    beats = received(tracer.trace(pulses), pulses, ready)
    slar.add(beats, pulses.measured)
    sar.add(beats, pulses.measured)
real = to_ground(slar.image(), 0.0, pixels.across_m)
focused = sar.image()

# %%
# How fine they are: the lone reflector, measured and in theory.
incidence = np.deg2rad(scenario.radar.scan.incidence_deg)
theory = azimuth_resolution_m(aperture, ready.chirp.wavelength_m), ground_range_resolution_m(
    ready.chirp, WINDOW, incidence
)
lone = scenario.targets[-1].position_m
row = int(np.argmin(np.abs(pixels.across_m + lone[1])))
near = np.abs(pixels.along_m + start_east - lone[0]) < 0.5
fine = half_power_width(pixels.along_m[near], focused.power[row, near])
lit = np.abs(real.along_m + start_east - lone[0]) < 2.5
coarse = half_power_width(real.along_m[lit], real.power[lit, row])
print(f"along the track: real aperture {coarse:.2f} m, focused {fine:.3f} m (theory {theory[0]:.3f} m)")
print(f"across the track, on the ground: {theory[1]:.2f} m")


# %%
# Side by side, in the survey's own colours: brighter is stronger.
def decibels(power: np.ndarray) -> np.ndarray:
    return 10 * np.log10(np.maximum(power, 1e-300) / np.nanmedian(power))


figure = Figure(figsize=(8, 8.4), layout="constrained")
upper, lower = figure.subplots(2, 1, sharex=True)
edges = (pixels.across_m[0], pixels.across_m[-1])
for axes, power, along, title in (
    (upper, real.power.T, real.along_m, f"Real aperture (SLAR): {coarse:.1f} m along the track"),
    (lower, focused.power, pixels.along_m, f"The same pulses focused (SAR): {100 * fine:.0f} cm along the track"),
):
    extent = (along[0] + start_east, along[-1] + start_east, *edges)
    picture = axes.imshow(
        decibels(power), origin="lower", extent=extent, cmap="viridis", vmin=-12, vmax=22, aspect="auto"
    )
    axes.set(ylabel="Ground range (m)", title=title)
    axes.axvline(0.0, color="white", lw=0.8, ls=":")
lower.set(xlabel="East, along the track (m)", xlim=(pixels.along_m[0] + start_east, pixels.along_m[-1] + start_east))
figure.colorbar(picture, ax=(upper, lower), label="Power over the median (dB)", extend="both")
figure.savefig("sar.png", dpi=130)
