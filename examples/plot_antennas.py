"""
Antennas from files and from elements
=====================================

A pattern as its maker measured it, and an array that steers its beam by phases: what each sends where, and the map that
an electronic scan makes of the hills. Elements farther apart than half a wavelength bring grating lobes.
"""

# %%
import os
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, run
from sionna_radar.radar import build_antenna, steered
from sionna_radar.readers.antennas import read_pattern
from sionna_radar.scenario import ArrayAntennaTable, PatternAntennaTable

SMALL = "SIONNA_RADAR_SMALL" in os.environ
BLUE, ORANGE, GREEN = "#0072b2", "#d55e00", "#009e73"  # safe for colour-blind readers

# %%
# A file as it comes from a chamber: two cuts, every half degree, relative dB, with a floor and one shoulder.
angle_deg = np.arange(-90.0, 90.25, 0.5)
azimuth_db = np.maximum(-12 * (angle_deg / 4.0) ** 2, -32 + 2 * np.cos(angle_deg / 1.7))
elevation_db = np.maximum(-12 * (angle_deg / 6.0) ** 2, -30 + 3 * np.cos(angle_deg / 2.3))
elevation_db = np.maximum(elevation_db, -14 - 3 * ((angle_deg - 11) / 3) ** 2)
folder = Path(tempfile.mkdtemp())
measured = folder / "measured.csv"
rows = np.column_stack([angle_deg, azimuth_db, elevation_db])
np.savetxt(measured, rows, "%.3f", ",", header="angle_deg,azimuth_db,elevation_db", comments="")

antenna = build_antenna(PatternAntennaTable(pattern=measured))
width_deg = np.rad2deg(antenna.beamwidths_rad)
directivity_db = 10 * np.log10(read_pattern(measured, "pattern").directivity)
print(f"measured: half-power beam {width_deg[0]:.2f} x {width_deg[1]:.2f} deg, directivity {directivity_db:.1f} dBi")


# %%
# Arrays of 32 by 32 elements, half and 0.8 wavelengths apart, steered to 35 deg.
def cut_db(antenna, angle_deg, steered_deg=0.0):
    """Gain against the angle from the normal of the face, in the plane of steering."""
    angle = np.deg2rad(angle_deg - steered_deg)
    direction = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    return 10 * np.log10(np.maximum(antenna.gain(direction), 1e-3))


steering_deg = 35.0
arrays = {
    spacing: build_antenna(ArrayAntennaTable(elements=(32, 32), spacing_wavelengths=spacing, taper_db=-25.0))
    for spacing in (0.5, 0.8)
}

# %%
# The hills, scanned by the closer array: the beam goes from left to right four times a second, nothing turns.
survey = run(
    load_scenario(
        "hills",
        {
            "radar.antenna": {"elements": [32, 32], "taper_db": -25.0},
            "radar.scan": {"mode": "electronic", "beams": 9 if SMALL else 45, "scans_per_s": 8.0 if SMALL else 4.0},
            "platform.start_m": [-80.0, 0.0],
            "platform.length_m": 5.0 if SMALL else 60.0,
        },
    )
)
lit = survey.lit_error
print(f"electronic scan: RMS error {lit.rms_m:.3f} m over lit cells, coverage {lit.coverage:.1%}")

# %%
figure = Figure(figsize=(15, 4.8), layout="constrained")
files, faces, ground = figure.subplots(1, 3, width_ratios=[1.0, 1.0, 1.1])
fine = np.linspace(-40, 40, 2001)
for axis, power_db, color, name in ((1, azimuth_db, BLUE, "azimuth"), (2, elevation_db, ORANGE, "elevation")):
    direction = np.zeros((len(fine), 3))
    direction[:, 0], direction[:, axis] = np.cos(np.deg2rad(fine)), np.sin(np.deg2rad(fine))
    gain_db = 10 * np.log10(np.maximum(antenna.gain(direction) / antenna.peak_gain, 1e-6))
    files.plot(fine, gain_db, color=color, lw=1.2, label=f"Used, {name}")
    files.plot(angle_deg[::2], power_db[::2], ".", color=color, ms=3.5, label=f"File, {name}")
files.set(xlim=(-40, 40), ylim=(-40, 2), xlabel="Angle from boresight (deg)", ylabel="Gain over the peak's (dB)")
files.set_title(f"A measured pattern: {directivity_db:.1f} dBi", fontsize="medium")
files.legend(frameon=False, fontsize="small", loc="upper left")

wide = np.linspace(-90, 90, 4001)
for (spacing, array), color in zip(arrays.items(), (BLUE, ORANGE), strict=True):
    beam = steered(array, np.deg2rad(steering_deg))
    faces.plot(wide, cut_db(beam, wide, steering_deg), color=color, lw=1.0, label=f"{spacing:g} wavelengths apart")
lobe_deg = np.rad2deg(np.arcsin(np.sin(np.deg2rad(steering_deg)) - 1 / 0.8))
faces.axvline(lobe_deg, color="0.4", ls=":", lw=1.0)
faces.text(lobe_deg + 2, 33.5, f"Grating lobe: {lobe_deg:.1f} deg", color="0.25", fontsize="small")
faces.set(xlim=(-90, 90), ylim=(-20, 38), xlabel="Angle from the array's normal, left (deg)", ylabel="Gain (dBi)")
faces.set_title(f"Arrays of 32 x 32 elements, steered to {steering_deg:g} deg", fontsize="medium")
faces.legend(frameon=False, fontsize="small", loc="lower left")

west, east, south, north = survey.error.grid.extent_m
error = survey.error.within(survey.lit).height_m
shown = ground.imshow(error, origin="lower", extent=(west, east, south, north), cmap="RdBu_r", vmin=-0.5, vmax=0.5)
ground.set(xlabel="East (m)", ylabel="North (m)")
ground.set_title(f"Electronic scan: DEM minus truth, RMS {survey.lit_error.rms_m:.2f} m", fontsize="medium")
figure.colorbar(shown, ax=ground, label="Error (m)", shrink=0.85)
for axes in (files, faces):
    axes.grid(alpha=0.3)
figure.savefig("antennas.png", dpi=150)
