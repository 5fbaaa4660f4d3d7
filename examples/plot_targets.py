"""
Targets that move, turn and have a shape
========================================

A rounded van drives under a radar that hovers, and a drone with four propellers hovers under it: the cross-section of
the van from all sides by physical optics, its range profile as it passes, and the micro-Doppler of the propellers.
With SIONNA_RADAR_SMALL=1 in the environment there are fewer directions and pulses.
"""

# %%
import os

import numpy as np
import trimesh
from matplotlib.figure import Figure

from sionna_radar import parse_scenario, prepare
from sionna_radar.scenario import TargetMesh
from sionna_radar.signal import add_noise, synthesise
from sionna_radar.tracing import rcs_of_mesh

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"

# %%
# The van: 5 x 2 x 1.5 m, rounded: the cubes of its scaled coordinates add up to one. Its y axis points ahead.
van = trimesh.creation.icosphere(subdivisions=5 if SMALL else 6)
van.vertices /= np.sum(np.abs(van.vertices) ** 3, axis=1, keepdims=True) ** (1 / 3)
van.vertices *= [1.0, 2.5, 0.75]
van.export("van.ply")

# %%
# What a radar 20 deg over its horizon sees of it: round sides that flash.
azimuth = np.deg2rad(np.linspace(-180, 180, 61 if SMALL else 481))
rcs_dbsm = 10 * np.log10(rcs_of_mesh(TargetMesh(path="van.ply"), 77e9, azimuth, np.deg2rad([0.0, 20.0])) + 1e-9)
print(f"the van returns {rcs_dbsm.max():.0f} dBsm at most, and {np.median(rcs_dbsm[1]):.0f} in the median at 20 deg")


# %%
# Two flights over level ground: the radar hovers and looks ahead, 30 deg off nadir.
def hovering(targets, chirp_rate_hz, beamwidth_deg, seconds):
    """Return times, ranges and complex range profiles of a hovering radar."""
    scenario = parse_scenario(
        {
            "terrain": {"kind": "flat", "size_m": [160.0, 160.0]},
            "platform": {
                "altitude_m": 30.0,
                "speed_mps": 0.01,
                "length_m": 0.01 * seconds,
                "start_m": [0.0, 0.0],
                "heading_deg": 0.0,
            },
            "radar": {
                "transmit_power_dbm": 12.0,
                "noise_figure_db": 12.0,
                "chirp_rate_hz": chirp_rate_hz,
                "samples_per_chirp": 512,
                "antenna": {"beamwidth_deg": beamwidth_deg},
                "scan": {"mode": "fixed", "incidence_deg": 30.0},
            },
            "targets": targets,
        }
    )
    prepared = prepare(scenario)
    profiles, analyser, tracer = [], prepared.instrument.detector.analyser, prepared.sensor_inputs().tracer()
    for pulses in prepared.flight.blocks(256):
        clean = synthesise(tracer.trace(pulses), pulses, prepared.receiver.chirp)
        profiles.append(analyser.amplitude(add_noise(clean, prepared.receiver.noise_power_w, 1, pulses.index)))
    return np.arange(sum(map(len, profiles))) / chirp_rate_hz, analyser.range_m, np.concatenate(profiles)


way = {"position_m": [-6.0, 17.0], "waypoints_m": [[6.0, 17.0]], "speed_mps": 8.0, "height_m": 0.95}
way["mesh"] = {"path": "van.ply"}
time_s, range_m, passing = hovering([way], 100.0 if SMALL else 400.0, 12.0, 1.5)
blade = {"radius_m": 0.12, "rotation_rpm": 4800.0, "rcs_dbsm": -20.0, "points": 16}
places = [(0.2, 0.2), (0.2, -0.2), (-0.2, 0.2), (-0.2, -0.2)]
rotors = [
    {**blade, "offset_m": [*place, 0.0], "axis": "up", "rotation_rpm": sign * 4800.0}
    for place, sign in zip(places, (1, -1, -1, 1), strict=True)
]
drone = {"position_m": [0.0, 13.0], "height_m": 8.0, "rcs_dbsm": -15.0, "rotors": rotors}
fast_s, fast_m, hover = hovering([drone], 80_000.0, 12.0, 0.02 if SMALL else 0.05)

# %%
# The propellers: a transform over 64 chirps at a time in the drone's range cell.
cell = int(np.argmin(np.abs(fast_m - np.hypot(13.0, 22.0))))
starts = np.arange(0, len(fast_s) - 64, 8)
frames = np.stack([hover[start : start + 64, cell] * np.hanning(64) for start in starts])
spectra = np.fft.fftshift(np.abs(np.fft.fft(frames, 256, axis=1)) ** 2, axes=1)
rate_mps = np.fft.fftshift(np.fft.fftfreq(256, 1 / 80_000.0)) * 3.894e-3 / 2
print(f"tips at {0.12 * 2 * np.pi * 80:.0f} m/s, seen at {np.sin(np.arctan2(13, 22)):.2f} of that")

# %%
figure = Figure(figsize=(12, 4.2), layout="constrained")
polar = figure.add_subplot(1, 3, 1, projection="polar", theta_offset=np.pi / 2, theta_direction=-1)
for level, colour in zip(rcs_dbsm, ("#0072b2", "#d55e00"), strict=True):
    polar.plot(azimuth, np.maximum(level, -30), color=colour, linewidth=0.8)
polar.set_rlim(-30, 50)
polar.set_title("Van (dBsm) from its horizon (blue)\nand 20 deg above it (orange)")
axes = figure.add_subplot(1, 3, 2)
power_db = 20 * np.log10(np.abs(passing))
shown = axes.pcolormesh(time_s, range_m, power_db.T, vmin=power_db.max() - 60, rasterized=True)
axes.set(ylim=(28, 40), xlabel="Time (s)", ylabel="Range (m)", title="It passes under the beam")
figure.colorbar(shown, ax=axes, label="Power (dB)")
axes = figure.add_subplot(1, 3, 3)
power_db = 10 * np.log10(spectra)
shown = axes.pcolormesh(1e3 * fast_s[starts + 32], -rate_mps, power_db.T, vmin=power_db.max() - 70, rasterized=True)
axes.set(xlabel="Time (ms)", ylabel="Range rate (m/s)", title="Four propellers and their drone")
figure.colorbar(shown, ax=axes, label="Power (dB)")
figure.savefig("targets.png", dpi=110)
