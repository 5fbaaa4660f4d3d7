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
from matplotlib.patheffects import withStroke

from sionna_radar import load_scenario, prepare
from sionna_radar.detection import SpectrumAnalyser
from sionna_radar.studies.images import (
    BackProjection,
    SideLooking,
    azimuth_resolution_m,
    ground_pixels,
    ground_range_resolution_m,
    half_power_width,
    real_aperture_resolution_m,
    to_ground,
    whole_beam,
)

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
WINDOW = "hann"
HALO = withStroke(linewidth=2.5, foreground="black")
overrides = {}
if SMALL:
    overrides = {"platform.length_m": 6.0, "platform.start_m": [-2.0, 0.0], "tracing.scatterers_per_m2": 10.0}
scenario = load_scenario("slar", overrides)

# %%
# The survey: what the radar receives, block by block, with the measured poses of its pulses.
prepared = prepare(scenario)
tracer = prepared.sensor_inputs().tracer()
track = prepared.flight.sample(2).measured
start_east = track.position_m[0, 0]
length = track.position_m[1, 0] - start_east

# %%
# Both images grow from the same pulses. The ends of the track are left out: their aperture is not flown whole.
margin = 2.0
aperture = whole_beam(prepared.instrument.antenna)
step = 0.04 if SMALL else 0.02
pixels = ground_pixels(
    track, "right", 0.0, np.arange(margin, length - margin, step), np.arange(22.0, 35.0, 0.3 if SMALL else 0.15)
)
slar = SideLooking(SpectrumAnalyser(prepared.receiver.chirp, WINDOW, 4), step_m=0.1)
sar = BackProjection(prepared.receiver.chirp, pixels, aperture, WINDOW)
# A third image, of a line through the lone reflector, is fine enough to measure its width.
east, north = scenario.targets[-1].position_m
line = ground_pixels(track, "right", 0.0, east - start_east + np.linspace(-0.15, 0.15, 101), np.array([-north]))
reflector = BackProjection(prepared.receiver.chirp, line, aperture, WINDOW)
for pulses in prepared.flight.blocks(64):
    beats = prepared.receiver.beat(tracer.trace(pulses), pulses)
    slar.add(beats, pulses.measured)
    sar.add(beats, pulses.measured)
    reflector.add(beats, pulses.measured)
slant = slar.image()
real_power = to_ground(slant, 0.0, pixels.across_m)
focused = sar.image()

# %%
# How fine they are: in theory, and the lone reflector as measured.
range_m = float(np.hypot(north, scenario.platform.altitude_m))
coarse = real_aperture_resolution_m(prepared.instrument.antenna.azimuth, range_m)
theory = azimuth_resolution_m(aperture, prepared.receiver.chirp.wavelength_m)
fine = half_power_width(line.along_m, reflector.image().power[0])
ground = ground_range_resolution_m(prepared.receiver.chirp, WINDOW, np.deg2rad(scenario.radar.scan.incidence_deg))
print(f"along the track: real aperture {coarse:.2f} m, focused {1e3 * fine:.1f} mm (theory {1e3 * theory:.1f} mm)")
print(f"across the track, on the ground: {ground:.2f} m")


# %%
# One above the other. The building leans toward the track and hides the ground behind it; right of the dotted line the
# field scatters 3 dB more; of the three reflectors, two stand 40 cm apart.
def decibels(power: np.ndarray) -> np.ndarray:
    return 10 * np.log10(np.maximum(power, 1e-300) / np.nanmedian(power))


def outline(centres: np.ndarray) -> tuple[float, float]:
    half = (centres[1] - centres[0]) / 2
    return centres[0] - half, centres[-1] + half


figure = Figure(figsize=(8, 8.4), layout="constrained")
upper, lower = figure.subplots(2, 1, sharex=True)
for axes, power, along, title in (
    (upper, real_power.T, slant.along_m, f"Real aperture (SLAR): resolves {coarse:.1f} m along the track"),
    (lower, focused.power, pixels.along_m, f"The same pulses focused (SAR): resolves {100 * fine:.0f} cm"),
):
    extent = (*outline(along + start_east), *outline(pixels.across_m))
    picture = axes.imshow(
        decibels(power), origin="lower", extent=extent, cmap="viridis", vmin=-12, vmax=22, aspect="auto"
    )
    axes.set(ylabel="Ground range (m)", title=title)
    axes.axvline(0.0, color="white", lw=0.8, ls=":")
lower.set(xlabel="East, along the track (m)", xlim=(pixels.along_m[0] + start_east, pixels.along_m[-1] + start_east))
notes = {
    "Building": (-2.0, 25.95),
    "Its shadow": (-2.0, 28.2),
    "Field, 3 dB more": (3.2, 33.8),
    "Two reflectors": (2.2, 25.1),
}
for text, (x, y) in notes.items():
    if lower.get_xlim()[0] < x < lower.get_xlim()[1]:
        lower.text(x, y, text, color="white", ha="center", va="bottom", weight="bold", path_effects=[HALO])
figure.colorbar(picture, ax=(upper, lower), label="Power over the median (dB)", extend="both")
figure.savefig("sar.png", dpi=130)
