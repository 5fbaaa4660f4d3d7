"""
Ground that the wind moves
==========================

Two fields side by side, one with 15 dB more backscatter, focused to a synthetic aperture: at rest, as plants in the
wind, and as water whose ripples run toward the radar. What moves along the line of sight is focused beside its place,
or not at all. With SIONNA_RADAR_SMALL=1 in the environment the image is coarse.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, prepare
from sionna_radar.signal import synthesise
from sionna_radar.studies.images import BackProjection, ground_pixels, whole_beam

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
BARE = {"materials.strong.gamma_db": -13.0, "buildings": [], "targets": []}
SIZE = {"tracing.scatterers_per_m2": 4.0 if SMALL else 40.0}
PLANTS = {"materials.strong.motion": "plants", "materials.weak.motion": "plants"}
CASES = {
    "nothing moves": {},
    "plants, wind of 2 m/s": PLANTS | {"weather.wind_mps": [2.0, 0.0, 0.0]},
    "plants, wind of 10 m/s": PLANTS | {"weather.wind_mps": [10.0, 0.0, 0.0]},
    "water, 3 m/s toward the radar": {
        "materials.strong.motion": "water",
        "materials.strong.fetch_m": 300.0,
        "weather.wind_mps": [0.0, 3.0, 0.0],
    },
}


# %%
# One image for each: back-projection of what the side-looking radar of `slar` receives, without noise.
def focused(changes):
    """Return the power of an image, places along the track, and ranges on the ground."""
    prepared = prepare(load_scenario("slar", BARE | SIZE | changes))
    track, tracer = prepared.flight.sample(2).measured, prepared.sensor_inputs().tracer()
    start, end = track.position_m[:, 0]
    along = np.arange(2.0, end - start - 2.0, 0.1 if SMALL else 0.02)
    across = np.arange(24.0, 32.0, 0.3)
    image = BackProjection(
        prepared.receiver.chirp,
        ground_pixels(track, "right", 0.0, along, across),
        whole_beam(prepared.instrument.antenna),
        "hann",
    )
    for pulses in prepared.flight.blocks(256):
        image.add(synthesise(tracer.trace(pulses), pulses, prepared.receiver.chirp), pulses.measured)
    return image.image().power, start + along, across


# %%
# The border of the fields is at 0. Still it is sharp; plants smear it; what water returns comes to lie 2 m aside,
# and much of it outside of what the beam's width of Doppler shifts focuses.
figure = Figure(figsize=(12, 5.6), layout="constrained")
axes = figure.subplots(2, len(CASES), sharex=True)
reference_db = None
for column, (name, changes) in enumerate(CASES.items()):
    power, east, across = focused(changes)
    power = power if power.shape == (len(across), len(east)) else power.T
    power_db = 10 * np.log10(np.maximum(power, 1e-30))
    reference_db = np.percentile(power_db, 95) if reference_db is None else reference_db
    shown = axes[0, column].pcolormesh(
        east, across, power_db - reference_db, vmin=-30, vmax=0, cmap="gray", rasterized=True
    )
    axes[0, column].set_title(name)
    mean_db = 10 * np.log10(power.mean(axis=0)) - reference_db
    steps = max(1, round(0.3 / (east[1] - east[0])))
    axes[1, column].plot(east, np.convolve(mean_db, np.ones(steps) / steps, mode="same"))
    axes[1, column].axvline(0.0, color="0.5", linestyle=":")
    axes[1, column].set(xlabel="East (m)", ylim=(-30, 3), xlim=(-4, 4))
    edge = mean_db[np.abs(east + 3) < 0.7].mean(), mean_db[np.abs(east - 3) < 0.7].mean()
    print(f"{name}: dark field {edge[0]:.1f} dB, bright field {edge[1]:.1f} dB")
axes[0, 0].set_ylabel("Distance from the track (m)")
axes[1, 0].set_ylabel("Mean over the distance (dB)")
figure.colorbar(shown, ax=axes[0], label="Power (dB)")
figure.savefig("moving_ground.png", dpi=110)
