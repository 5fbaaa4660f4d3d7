"""
Ground from a point cloud, and detail below a raster's spacing
==============================================================

A LAZ file with ground and trees becomes two worlds: the first returns, which the radar sees, and the bare ground that
is classified as such. A coarse raster of the same ground gets seeded detail below its spacing.
"""

# %%
import logging
import os
import tempfile
from pathlib import Path

import laspy
import numpy as np
import rasterio
from matplotlib.figure import Figure
from pyproj import CRS

from sionna_radar import load_scenario, run

SMALL = "SIONNA_RADAR_SMALL" in os.environ
logging.getLogger("sionna_radar").setLevel(logging.ERROR)  # it says what is filled and what is added
EAST, NORTH, SIDE = 690_000.0, 5_330_000.0, 360.0
folder = Path(tempfile.mkdtemp())


def ground_m(x, y):
    """Height above the ellipsoid of some rolling ground."""
    return 520 + 6 * np.sin(x / 38) * np.cos(y / 51) + 0.04 * x


# %%
# The cloud: six points a square metre, and a hundred trees whose crowns return first.
generator = np.random.default_rng(3)
count = int((2 if SMALL else 6) * SIDE**2)
x, y = generator.uniform(0, SIDE, (2, count))
z = ground_m(x, y) + generator.normal(0, 0.03, count)
crown = np.zeros(count)
for east, north in generator.uniform(30, SIDE - 30, (100, 2)):
    apart = np.hypot(x - east, y - north)
    crown = np.maximum(crown, np.where(apart < 3.5, 9 * np.sqrt(np.maximum(1 - (apart / 3.5) ** 2, 0)), 0))
tree = crown > 0.5

header = laspy.LasHeader(point_format=6, version="1.4")
header.offsets, header.scales = [EAST, NORTH, 0.0], [0.001, 0.001, 0.001]
header.add_crs(CRS.from_epsg(32632))
cloud = laspy.LasData(header)
# Under a crown each pulse has two returns: the crown, and the ground.
cloud.x, cloud.y = np.append(x, x[tree]) + EAST, np.append(y, y[tree]) + NORTH
cloud.z = np.append(z + np.where(tree, crown, 0.0), z[tree])
cloud.classification = np.append(np.where(tree, 5, 2), np.full(tree.sum(), 2))
cloud.return_number = np.append(np.ones(count, dtype=int), np.full(tree.sum(), 2))
cloud.number_of_returns = np.append(np.where(tree, 2, 1), np.full(tree.sum(), 2))
cloud.write(folder / "cloud.laz")

# %%
# The raster: the same ground every 12 m.
posts = np.arange(0.0, SIDE + 1, 12.0)
east, north = np.meshgrid(posts, posts[::-1])
place = rasterio.Affine(12.0, 0.0, EAST - 6.0, 0.0, -12.0, NORTH + SIDE + 6.0)
shape = {"height": len(posts), "width": len(posts), "count": 1, "dtype": "float32"}
with rasterio.open(folder / "dem.tif", "w", driver="GTiff", crs="EPSG:32632", transform=place, **shape) as file:
    file.write(ground_m(east, north).astype(np.float32), 1)

# %%
# One flight over each of the three.
FLIGHT = {
    "platform.start_m": [-90.0, 0.0],
    "platform.length_m": 10.0 if SMALL else 90.0,
    "radar.antenna.beamwidth_deg": 2.0,
}
WORLDS = {
    "First returns": {"kind": "points", "path": str(folder / "cloud.laz"), "spacing_m": 1.0, "statistic": "max"},
    "Classified as ground": {"kind": "points", "path": str(folder / "cloud.laz"), "spacing_m": 1.0, "points": "ground"},
    "A raster of 12 m, roughened": {
        "kind": "raster",
        "path": str(folder / "dem.tif"),
        "spacing_m": 1.0,
        "roughen": {"hurst": 0.7, "rms_m": 0.25},
    },
}
surveys = {name: run(load_scenario("hills", {"terrain": world, **FLIGHT})) for name, world in WORLDS.items()}
for name, survey in surveys.items():
    print(f"{name}: RMS {survey.lit_error.rms_m:.3f} m, NMAD {survey.lit_error.nmad_m:.3f} m")

# %%
figure = Figure(figsize=(13, 7.2), layout="constrained")
rows = figure.subplots(2, 3, sharex=True, sharey=True)
for column, (name, survey) in zip(rows.T, surveys.items(), strict=True):
    west, east, south, north = survey.truth.grid.extent_m
    height_m = survey.truth.height_m
    error_m = survey.error.within(survey.lit).height_m
    area = {"origin": "lower", "extent": (west, east, south, north)}
    world = column[0].imshow(height_m - np.nanmin(height_m), cmap="gist_earth", vmin=0, vmax=18, **area)
    error = column[1].imshow(error_m, cmap="RdBu_r", vmin=-1, vmax=1, **area)
    column[0].set_title(name, fontsize="medium")
    column[1].set_title(f"DEM minus truth: RMS {survey.lit_error.rms_m:.2f} m", fontsize="medium")
    column[1].set_xlabel("East (m)")
for axes in rows[:, 0]:
    axes.set_ylabel("North (m)")
figure.colorbar(world, ax=rows[0], label="True surface (m)", shrink=0.8)
figure.colorbar(error, ax=rows[1], label="Error (m)", shrink=0.8)
figure.savefig("point_cloud.png", dpi=120)
