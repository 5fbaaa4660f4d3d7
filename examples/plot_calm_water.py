"""
Calm water: a flash, and silence
================================

A pond in hills. Water as smooth as glass is a mirror: straight below it returns the radar's own image, far stronger
than any ground, and aside nothing at all. The map leaves the pond empty and says why (`no_echo`); a lidar, whose light
is mirrored away as well, fails there too. Along its border the beam's skirt still meets the shore, whose echo is placed
on the axis, over the water or under it. With SIONNA_RADAR_SMALL=1 in the environment the flights are short ones.
"""

# %%
import os
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter

from sionna_radar import load_scenario, prepare, run
from sionna_radar.report import finish_map

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
SIZE = {"platform.start_m": [-62.0, 0.0], "platform.length_m": 15.0, "tracing.paths_per_pulse": 64} if SMALL else {}
RADIUS_M, HALF_M, ALTITUDE_M = 24.0, 170, 50.0

# %%
# The world: hills that end in a level shore around the pond, as a file.
middle = np.arange(-HALF_M, HALF_M) + 0.5
x, y = np.meshgrid(middle, middle[::-1])
hills = gaussian_filter(np.random.default_rng(4).normal(size=x.shape), 22.0, mode="wrap")
shore = np.clip((np.hypot(x, y) - RADIUS_M - 3.0) / 25.0, 0.0, 1.0)
height = 8.0 * (hills - hills.min()) / np.ptp(hills) * shore**2 * (3 - 2 * shore)
folder = Path(tempfile.mkdtemp())
corner = f"xllcorner {500_000 - HALF_M}\nyllcorner {5_000_000 - HALF_M}\n"
head = f"ncols {2 * HALF_M}\nnrows {2 * HALF_M}\n{corner}cellsize 1\n"
rows = "\n".join(" ".join(f"{value:.3f}" for value in row) for row in height)
(folder / "pond.asc").write_text(head + rows + "\n")
turn = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
POND = (RADIUS_M * np.column_stack([np.cos(turn), np.sin(turn)])).tolist()
CALM = {
    "model": "small_perturbation",
    "medium": {"kind": "water", "temperature_c": 10.0},
    "rms_height_m": 1e-5,
    "correlation_length_m": 0.01,
    "specular": True,
}


def over_pond(**changes):
    return load_scenario(
        "hills",
        {
            "terrain": {
                "kind": "raster",
                "path": str(folder / "pond.asc"),
                "crs": "EPSG:32632",
                "cover": [{"polygon_m": POND, "material": "water"}],
            },
            "materials.water": CALM,
            "platform.altitude_m": ALTITUDE_M,
            "platform.height": "level",
            "platform.start_m": [-110.0, 0.0],
            "platform.length_m": 130.0,
            "radar.samples_per_chirp": 2048,
            "radar.snr_db": 15.0,
            "dem.method": "linear",
            "lidar.wavelength_nm": 905,
            "lidar.reflectivities": {"water": 0.0},
            **SIZE,
            **changes,
        },
    )


# %%
# Radar and lidar over the same ground.
figure = Figure(figsize=(12.5, 9.0), layout="constrained")
(maps, lower) = figure.subplots(2, 2)
surveys = {"Radar": run(over_pond()), "Lidar": run(over_pond(sensor="lidar"))}
for axes, (name, survey) in zip(maps, surveys.items(), strict=True):
    grid = survey.dem.grid
    on_pond = np.hypot(*grid.centres_m.T).reshape(grid.shape) < RADIUS_M
    pond = survey.lit & on_pond
    print(
        f"{name}: of the pond's {pond.sum()} lit cells {np.mean(survey.no_echo[pond]):.0%} have no echo and "
        f"{np.mean(survey.dem.filled[pond]):.0%} a height; elsewhere {(survey.no_echo & ~on_pond).sum()} without; "
        f"lit cells {survey.lit_error.rms_m:.2f} m RMS"
    )
    picture = axes.imshow(
        survey.dem.height_m, extent=grid.extent_m, origin="lower", cmap="terrain", vmin=-3.0, vmax=12.0
    )
    silent = np.zeros((*grid.shape, 4))
    silent[survey.no_echo] = (0.03, 0.19, 0.42, 1.0)
    axes.imshow(silent, extent=grid.extent_m, origin="lower")
    axes.plot(*np.array([*POND, POND[0]]).T, color="black", lw=1.0)
    finish_map(axes, grid.extent_m, f"{name}: heights, and where nothing came back (dark blue)")
figure.colorbar(picture, ax=maps, label="DEM height (m)", shrink=0.8)

# %%
# Where the radar's echoes are placed along the track.
section, angles = lower
place = surveys["Radar"].points.position_m
near = np.abs(place[:, 1]) < 15.0
section.scatter(place[near, 0], place[near, 2], s=5, color="#b2182b", lw=0, label="Echoes within 15 m of the track")
truth = surveys["Radar"].truth
section.plot(truth.grid.x_m, truth.height_m[truth.grid.rows // 2], color="black", lw=1.0, label="Ground and water")
section.axvspan(-RADIUS_M, RADIUS_M, color="#2166ac", alpha=0.15, label="Pond")
section.set(xlabel="East (m)", ylabel="Height (m)", title="Radar's echoes, placed on its axis")
section.legend(frameon=False, loc="upper left")
over = near & (np.hypot(place[:, 0], place[:, 1]) < RADIUS_M)
spread_m = np.ptp(place[over, 2]) if over.any() else 0.0
print(f"{over.sum()} echoes on the pond within 15 m of the track, {spread_m:.1f} m apart in height")

# %%
# What comes back against the angle from the plumb line, above the pond and above land.
nadir = {"radar.scan.incidence_deg": 0.0, "radar.scan.half_swath_deg": 60.0, "platform.length_m": 15.0}
for name, start, colour in (("Above the pond", -7.0, "#2166ac"), ("Above land", -95.0, "#8c510a")):
    prepared = prepare(over_pond(**nadir, **{"platform.start_m": [start, 0.0]}))
    pulses = prepared.flight.pulses(np.arange(len(prepared)))
    paths = prepared.sensor_inputs().tracer().trace(pulses)
    # Power of the strongest half metre of range, as a detector sees it.
    cell = pulses.row_of(paths.pulse) * 4096 + (paths.delay_s * 299792458.0).astype(np.int64)
    in_cell = np.bincount(cell, weights=np.abs(paths.gain) ** 2, minlength=len(pulses) * 4096)
    best = in_cell.reshape(len(pulses), 4096).max(axis=1)
    off = np.rad2deg(np.arccos(-pulses.true.boresight[:, 2])) * np.sign(pulses.scan_rad)
    order = np.argsort(off)
    angles.plot(off[order], 10 * np.log10(best[order]), ".", ms=3, color=colour, label=name)
height_m = pulses.true.position_m[0, 2]
reflection = abs(prepared.world.scene.materials["water"].mirror.amplitude)
image = prepared.instrument.antenna.peak_gain * reflection * 299792458.0 / 77e9 / (8 * np.pi * height_m)
noise = prepared.receiver.noise_power_w / prepared.receiver.transmit_power_w / 2048
angles.axhline(20 * np.log10(image), color="black", ls="--", lw=1.0, label="The radar's image in the water")
angles.axhline(10 * np.log10(noise), color="grey", ls=":", label="Noise in a range cell")
print(f"image {20 * np.log10(image):.1f} dB, noise in a range cell {10 * np.log10(noise):.1f} dB")
angles.set(xlabel="Beam from the plumb line (deg)", ylabel="dB rel. to transmitted", title="Strongest 0.5 m of range")
angles.set_ylim(-172, -30)
angles.legend(frameon=False, loc="lower left", ncols=2, fontsize="small")
angles.grid(alpha=0.3)
figure.suptitle("A calm pond in hills, 2 deg beam at 77 GHz from 50 m, 15 dB of signal to noise over land")
figure.savefig("calm_water.png", dpi=110, bbox_inches="tight")
