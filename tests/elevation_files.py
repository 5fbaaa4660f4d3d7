"""Elevation files of a known surface, and what is read from them."""

import numpy as np
import rasterio
from pyproj import CRS, Transformer
from rasterio import Affine

from sionna_radar.scenario.terrain import RasterTerrain
from worlds import load_ground

UTM = "EPSG:32632"
WEST, NORTH = 450_000.0, 5_000_100.0
EVERYWHERE = (-1e5, -1e5, 1e5, 1e5)


def from_origin(west, north, dx, dy):
    return Affine(dx, 0.0, west, 0.0, -dy, north)


def plane(x, y):
    """A height every bilinear look-up reproduces exactly, in whatever coordinates it is a plane."""
    return 300.0 + 0.05 * (x - WEST) - 0.03 * (y - NORTH)


def cell_centres(transform, rows, columns):
    column, row = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    a, b, c, d, e, f = tuple(transform)[:6]
    return a * column + b * row + c, d * column + e * row + f


def write_heights(path, height, transform, crs=UTM, **profile):
    rows, columns = height.shape
    profile = {"driver": "GTiff", "dtype": height.dtype, "count": 1, **profile}
    scales, units = profile.pop("scale_offset", None), profile.pop("units", None)
    with rasterio.open(path, "w", height=rows, width=columns, transform=transform, crs=crs, **profile) as file:
        for band in range(1, profile["count"] + 1):
            file.write(height if band == 1 else np.zeros_like(height), band)
        if scales:
            file.scales, file.offsets = [scales[0]], [scales[1]]
        if units:
            file.units = [units]
    return path


def write_plane(path, *, transform=None, rows=100, columns=120, crs=UTM, surface=plane, **profile):
    transform = transform or from_origin(WEST, NORTH, 1.0, 1.0)
    height = surface(*cell_centres(transform, rows, columns))
    return write_heights(path, np.asarray(height, np.float64), transform, crs=crs, **profile)


def load(path, window=EVERYWHERE, **fields):
    return load_ground(RasterTerrain(kind="raster", path=path, **fields), window)


def absolute(raster, georeference):
    """Coordinates and heights of all filled cells in the CRS of the georeference."""
    x, y = raster.grid.centres_m.T
    z = raster.height_m.ravel()
    keep = np.isfinite(z)
    origin = georeference.origin_m
    return x[keep] + origin[0], y[keep] + origin[1], z[keep] + origin[2]


def in_crs(georeference, crs, x, y):
    return Transformer.from_crs(CRS(georeference.crs_wkt), CRS(crs), always_xy=True).transform(x, y)
