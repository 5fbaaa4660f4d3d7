"""Reading of elevation files: the window of a survey, cropped and reprojected into its local metric frame.

The part is covered with cells of the local frame. `local_frame` chooses the frame, and `file_heights` interpolates the
heights of its cells from the file.
"""

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sionna_radar.elevation.file_heights import heights_on
from sionna_radar.elevation.local_frame import StatedFrame, data_bands, place_file
from sionna_radar.elevation.placed_raster import PlacedRaster
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Georeference, Grid, MapCells, Raster, spans
from sionna_radar.foundation.raster_band import UNDECLARED_NODATA

logger = logging.getLogger("sionna_radar")

MOVE = "move the flight (platform.log_shift = 'to_terrain' moves a log) or set terrain.centre_lonlat_deg"

MAX_CELLS = 4_000_000
# Bands that a warning names.
MAX_LISTED = 6
# Smaller cells indicate a wrong geotransform.
MIN_SPACING_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class Cutout:
    """The requested part of a file: the window in local metres (west, south, east, north) and the frame."""

    window_m: tuple[float, float, float, float]
    frame: StatedFrame
    spacing_m: float | None = None


def check_spacing(spacing_m: float, width_m: float, length_m: float) -> None:
    """Raise ScenarioError if a cell is larger than the visible part of the terrain."""
    if spacing_m > min(width_m, length_m):
        message = f"{spacing_m:g} exceeds the visible terrain, {width_m:g} x {length_m:g} m; lower it"
        raise ScenarioError.of("terrain.spacing_m", message)


def warn_of_coarser_cells(requested_m: float, spacing_m: float) -> None:
    """Warn that the visible part has more than MAX_CELLS of the requested spacing."""
    message = "terrain: the visible part has more than %s cells of %g m; coarsened to %g m. "
    message += "Shorten the flight or raise terrain.spacing_m"
    logger.warning(message, f"{MAX_CELLS:,}", requested_m, spacing_m)


def grid_of(source: PlacedRaster, cutout: Cutout) -> Grid:
    """Return the cells that cover the part of the window within the file, at most MAX_CELLS.

    In the file's own projection, unless it is turned, the cells are aligned with the file's.

    Raises ScenarioError if the file does not overlap the window, the overlap is smaller than one cell, or cells have no
    width.
    """
    west, south, east, north = _overlap_m(source, cutout)
    spacing = requested = cutout.spacing_m or float(f"{min(source.steps_m):.12g}")
    if not MIN_SPACING_M <= spacing < math.inf:
        message = (
            f"the file's cells are {spacing:g} m wide at its centre; correct its transform or CRS, or set a spacing"
        )
        raise ScenarioError.of("terrain.spacing_m", message)
    check_spacing(spacing, east - west, north - south)
    anchor = (0.0, 0.0)
    if source.is_aligned:
        x, y = source.local_of(np.zeros(1), np.zeros(1))
        anchor = float(x[0]), float(y[0])
    # The tolerance keeps a boundary at a cell centre from being rounded past it.
    while True:
        first_cell = [math.floor((lower - a) / spacing + 1e-6) for lower, a in zip((west, south), anchor, strict=True)]
        last_cell = [math.ceil((upper - a) / spacing - 1e-6) for upper, a in zip((east, north), anchor, strict=True)]
        columns, rows = (b - a + 1 for a, b in zip(first_cell, last_cell, strict=True))
        if columns * rows <= MAX_CELLS:
            break
        spacing *= math.ceil(100 * math.sqrt(columns * rows / MAX_CELLS)) / 100
    if spacing != requested:
        warn_of_coarser_cells(requested, spacing)
    origin = [a + k * spacing for a, k in zip(anchor, first_cell, strict=True)]
    return Grid(west_m=origin[0], south_m=origin[1], spacing_m=spacing, columns=columns, rows=rows)


def _overlap_m(source: PlacedRaster, cutout: Cutout) -> tuple[float, float, float, float]:
    """Return the intersection, in local metres, of the window and the file's cell centres."""
    lower, upper = np.zeros(2), np.array(source.dataset.shape[::-1]) - 1.0
    window_pixels = np.array(source.pixel_of(*_outline(cutout.window_m)))
    # A window that extends beyond the projection is not bounded by its outline.
    if np.isfinite(window_pixels).all():
        # Two cells of margin: a sampled outline may cut off a curved edge.
        lower = np.maximum(lower, np.floor(window_pixels.min(axis=1)) - 2)
        upper = np.minimum(upper, np.ceil(window_pixels.max(axis=1)) + 2)
    if (lower < upper).all():
        west, south, east, north = _extent_m(source, (*lower.tolist(), *upper.tolist()))
        # One cell of margin, so that the window lies between cell centres.
        step = max(source.steps_m)
        west, south = max(west, cutout.window_m[0] - step), max(south, cutout.window_m[1] - step)
        east, north = min(east, cutout.window_m[2] + step), min(north, cutout.window_m[3] + step)
        if west < east and south < north:
            return west, south, east, north
    raise outside(source, cutout, "the terrain file does not cover it")


def outside(source: PlacedRaster, cutout: Cutout, what: str) -> ScenarioError:
    """Return the error for a window without terrain, naming the field that set its position."""
    rows, columns = source.dataset.shape
    covered = _extent_m(source, (0.0, 0.0, columns - 1.0, rows - 1.0))
    message = f"the flight sees {spans(cutout.window_m)}, but {what}: the file covers {spans(covered)}"
    authority = source.local.to_authority()
    if authority and _matches_map_coordinates(source, cutout, covered):
        system = ":".join(authority)
        remedy = f"set coordinates = '{system}' if positions are on the map"
        return ScenarioError.of("terrain", f"{message} about the local origin; {remedy}")
    if cutout.frame.centre_lonlat_deg is None:
        return ScenarioError.of("terrain", f"{message}; {MOVE}")
    lon, lat = cutout.frame.centre_lonlat_deg
    return ScenarioError.of("terrain.centre_lonlat_deg", f"about ({lon:g}, {lat:g}) {message}; move the centre")


def _matches_map_coordinates(
    source: PlacedRaster, cutout: Cutout, covered_m: tuple[float, float, float, float]
) -> bool:
    """Return True if the window's middle, taken as map easting and northing, would be within the file."""
    west, south, east, north = cutout.window_m
    x, y = (west + east) / 2 - source.origin[0], (south + north) / 2 - source.origin[1]
    return covered_m[0] <= x <= covered_m[2] and covered_m[1] <= y <= covered_m[3]


def _extent_m(source: PlacedRaster, pixels: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """Return the local rectangle around a box of pixels (columns and rows), as far as the projection is valid."""
    x, y = source.local_of(*_outline(pixels))
    placed = np.isfinite(x) & np.isfinite(y)
    if not placed.any():
        return math.inf, math.inf, -math.inf, -math.inf
    x, y = x[placed], y[placed]
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def _outline(box: tuple[float, float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return points along the edges of a rectangle (low x, low y, high x, high y)."""
    low_x, low_y, high_x, high_y = box
    fraction = np.linspace(0, 1, 33)
    x, y = low_x + (high_x - low_x) * fraction, low_y + (high_y - low_y) * fraction
    ones = np.ones_like(fraction)
    return (
        np.concatenate([x, x, low_x * ones, high_x * ones]),
        np.concatenate([low_y * ones, high_y * ones, y, y]),
    )


@contextmanager
def opened_file(path: Path | str) -> Iterator[Any]:
    """Open a raster file that holds elevations.

    Raises InputFileError for a file that cannot be read or holds no elevations.
    """
    # rasterio, which nothing but a file needs, takes long to import.
    from sionna_radar.foundation.raster_file import open_raster

    with open_raster(path, "terrain.path") as dataset:
        _check_content(dataset, path)
        yield dataset


def _check_content(dataset: Any, path: Path | str) -> None:
    problem = None
    if dataset.count == 0:
        problem = "has no band, perhaps subdatasets; extract one with gdal_translate"
    elif dataset.count == 1 and np.dtype(dataset.dtypes[0]).kind not in "iuf":
        problem = f"holds {dataset.dtypes[0]} values, not heights; give an elevation raster"
    elif min(dataset.shape) < 2:
        problem = f"has {dataset.height} x {dataset.width} cells, too few for a surface; give at least 2 x 2"
    elif dataset.transform.is_identity:
        problem = "is not georeferenced; georeference it with gdal_translate or gdalwarp"
    elif dataset.transform.is_degenerate:
        problem = "has cells of zero size; repair its geotransform with gdal_translate -a_ullr"
    if problem:
        raise InputFileError(f"terrain.path = {shown(path)} {problem}")


def cut(dataset: Any, cutout: Cutout) -> tuple[Raster, Georeference]:
    """Return the heights of an open raster within a window, and the georeference of the frame.

    Raises ScenarioError for an unsuitable frame or window.
    """
    source = place_file(dataset, cutout.frame)
    bands = [*data_bands(dataset)]
    if cutout.frame.band is None and len(bands) > 1:
        names = ", ".join(f"{band} {dataset.descriptions[band - 1] or 'without a name'}" for band in bands[:MAX_LISTED])
        logger.warning(
            "terrain: band %d of %d is read (%s); set terrain.band to the one that holds the ground",
            source.band,
            len(bands),
            names,
        )
    grid = grid_of(source, cutout)
    height_m = heights_on(source, grid)
    corners = np.isfinite(height_m)
    if not (corners[:-1, :-1] & corners[:-1, 1:] & corners[1:, :-1] & corners[1:, 1:]).any():
        if not corners.any() and _is_empty(dataset, source.band):
            rows, columns = dataset.shape
            message = f"holds no height: all of its {columns:,} x {rows:,} cells are without data"
            raise InputFileError(f"terrain.path = {shown(dataset.name)} {message}; give another file")
        raise outside(source, cutout, f"no 2 x 2 cells of {grid.spacing_m:g} m there have heights")
    raster = _without_empty_border(Raster(grid=grid, height_m=height_m))
    base_m = math.floor(np.nanmin(raster.height_m))
    georeference = Georeference(
        crs_wkt=source.heights.compound(source.local).to_wkt(),
        origin_m=(*source.origin, float(base_m)),
        cells=_map_cells(source),
    )
    return Raster(grid=raster.grid, height_m=raster.height_m - base_m), georeference


def _is_empty(dataset: Any, band: int) -> bool:
    """Whether no cell of a band has data, declared or not."""
    windows = (window for _, window in dataset.block_windows(band))
    stored = (dataset.read(band, window=window, masked=True) for window in windows)
    with np.errstate(invalid="ignore"):
        return not any(
            bool(np.any((values != UNDECLARED_NODATA).filled(False) & np.isfinite(values.data))) for values in stored
        )


def _map_cells(source: PlacedRaster) -> MapCells | None:
    if not source.is_aligned:
        return None
    west, south, east, north = source.dataset.bounds
    transform = source.dataset.transform
    return MapCells(corner_m=(min(west, east), min(south, north)), size_m=(abs(transform.a), abs(transform.e)))


def _without_empty_border(raster: Raster) -> Raster:
    """Return the raster without outer rows and columns in which every cell is empty."""
    filled = np.argwhere(raster.filled)
    bounds = zip(filled.min(axis=0).tolist(), filled.max(axis=0).tolist(), strict=True)
    rows, columns = (slice(first, last + 1) for first, last in bounds)
    return Raster(grid=raster.grid.cut(rows, columns), height_m=raster.height_m[rows, columns])
