"""Elevation files of any projection, cut out and transformed into the local metric frame.

`local_frame` chooses the frame, `cutout` its cells, and `file_heights` interpolates their heights from the file.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from jaxtyping import Shaped
from rasterio.io import MemoryFile

from sionna_radar.elevation.cutout import Cutout, grid_of, outside
from sionna_radar.elevation.file_heights import heights_on
from sionna_radar.elevation.local_frame import place_file
from sionna_radar.elevation.placed_raster import PlacedRaster
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.georeference import Georeference, MapCells
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.foundation.raster_file import open_raster


@contextmanager
def opened_file(path: Path | str) -> Iterator[Any]:
    """Open a raster file whose first band holds elevations.

    Raises InputFileError for a file that cannot be read or holds no elevations.
    """
    with open_raster(path, "terrain.path") as dataset:
        _check_content(dataset, path)
        yield dataset


@contextmanager
def opened_array(height_m: Shaped[np.ndarray, "row column"], transform: rasterio.Affine) -> Iterator[Any]:
    """Open an array as if it were a raster file, georeferenced by its transform."""
    rows, columns = height_m.shape
    profile = {"driver": "GTiff", "count": 1, "dtype": height_m.dtype, "height": rows, "width": columns}
    with MemoryFile() as memory:
        with memory.open(**profile, transform=transform) as writable:
            writable.write(height_m, 1)
        with memory.open() as dataset:
            yield dataset


def _check_content(dataset: Any, path: Path | str) -> None:
    problem = None
    if dataset.count == 0:
        problem = "has no band, perhaps subdatasets; extract one with gdal_translate"
    elif np.dtype(dataset.dtypes[0]).kind not in "iuf":
        problem = f"holds {dataset.dtypes[0]} values, not heights; give an elevation raster"
    elif min(dataset.shape) < 2:
        problem = f"has {dataset.height} x {dataset.width} cells, too few for a surface; give at least 2 x 2"
    elif dataset.transform.is_identity:
        problem = "is not georeferenced; georeference it with gdal_translate or gdalwarp"
    elif dataset.transform.is_degenerate:
        problem = "has cells of zero size; repair its geotransform with gdal_translate -a_ullr"
    if problem:
        message = f"terrain.path = {shown(path)} {problem}"
        raise InputFileError(message)


def cut(dataset: Any, cutout: Cutout) -> tuple[Raster, Georeference]:
    """Return the heights of an open raster within a window, and the georeference of the frame.

    Raises ScenarioError for an unsuitable frame or window.
    """
    source = place_file(dataset, cutout.frame)
    grid = grid_of(source, cutout)
    height_m = heights_on(source, grid)
    corners = np.isfinite(height_m)
    if not (corners[:-1, :-1] & corners[:-1, 1:] & corners[1:, :-1] & corners[1:, 1:]).any():
        raise outside(source, cutout, f"no 2 x 2 cells of {grid.spacing_m:g} m there have heights")
    raster = _without_empty_border(Raster(grid=grid, height_m=height_m))
    base_m = math.floor(np.nanmin(raster.height_m))
    georeference = Georeference(
        crs_wkt=source.heights.compound(source.local).to_wkt(),
        origin_m=(*source.origin, float(base_m)),
        cells=_map_cells(source),
    )
    return Raster(grid=raster.grid, height_m=raster.height_m - base_m), georeference


def _map_cells(source: PlacedRaster) -> MapCells | None:
    if source.is_reprojected:
        return None
    west, south, east, north = source.dataset.bounds
    transform = source.dataset.transform
    return MapCells(corner_m=(min(west, east), min(south, north)), size_m=(abs(transform.a), abs(transform.e)))


def _without_empty_border(raster: Raster) -> Raster:
    """Return the raster without outer rows and columns in which every cell is empty."""
    filled = np.argwhere(raster.filled)
    (first_row, first_column), (last_row, last_column) = filled.min(axis=0), filled.max(axis=0)
    grid = raster.grid
    cropped = Grid(
        west_m=grid.west_m + int(first_column) * grid.spacing_m,
        south_m=grid.south_m + int(first_row) * grid.spacing_m,
        spacing_m=grid.spacing_m,
        columns=int(last_column - first_column) + 1,
        rows=int(last_row - first_row) + 1,
    )
    height_m = raster.height_m[first_row : last_row + 1, first_column : last_column + 1]
    return Raster(grid=cropped, height_m=height_m)
