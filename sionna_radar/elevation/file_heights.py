"""Heights of an elevation file at the cells of a grid.

The cells are interpolated from the file one by one (bilinear between its cell centres, after averaging if the file is
finer), not warped by GDAL, whose approximate transformer and half-cell extrapolation at edges and voids would cost
accuracy.
"""

import logging
import math

import numpy as np
from jaxtyping import Float
from rasterio.windows import Window
from scipy.ndimage import map_coordinates

from sionna_radar.elevation.placed_raster import PlacedRaster
from sionna_radar.foundation.raster import Grid

logger = logging.getLogger("sionna_radar")

# Cells of the file held in memory at once.
STRIP_CELLS = 4_000_000
# Beyond any height on Earth: a stand-in for "no data" that the file does not declare.
MAX_HEIGHT_M = 12_000.0
# -9999 is within that limit, but no land is that deep.
UNDECLARED_NODATA = -9999.0


def heights_on(source: PlacedRaster, grid: Grid) -> Float[np.ndarray, "row column"]:
    """Return bilinear heights at the grid's centres; NaN next to a cell without data."""
    column, row = source.pixel_of(*grid.centres_m.T)
    # Rounding must not turn an interpolation at a cell centre into one between two cells.
    column, row = (np.where(np.abs(c - np.rint(c)) < 1e-6, np.rint(c), c) for c in (column, row))
    rows, columns = source.dataset.shape
    inside = (column >= 0) & (column <= columns - 1) & (row >= 0) & (row <= rows - 1)
    height_m = np.full(grid.columns * grid.rows, np.nan)
    if inside.any():
        lookup = row[inside], column[inside]
        # Number of whole cells of the file in one target cell: this many are averaged.
        factor = [
            max(1, math.floor(min(n, grid.spacing_m / step + 1e-6)))
            for n, step in zip((rows, columns), reversed(source.steps_m), strict=True)
        ]
        row_slice, column_slice = (_span_of(c, f, n) for c, f, n in zip(lookup, factor, (rows, columns), strict=True))
        cells = _averaged(source, (row_slice, column_slice), (factor[0], factor[1]))
        # Block k holds the cells k f ... k f + f - 1, so its centre is at k f + (f - 1) / 2.
        in_blocks = [
            (c - w.start - (f - 1) / 2) / f for c, w, f in zip(lookup, (row_slice, column_slice), factor, strict=True)
        ]
        height_m[inside] = bilinear(cells, in_blocks[0], in_blocks[1])
    return height_m.reshape(grid.shape)


def _span_of(coordinate: Float[np.ndarray, " n"], factor: int, cells: int) -> slice:
    """Return the cells around the coordinates, starting at a block, with a margin of one block."""
    first = max(0, (int(coordinate.min()) // factor - 1) * factor)
    return slice(first, min(cells, (int(coordinate.max()) // factor + 2) * factor))


def _averaged(
    source: PlacedRaster, window: tuple[slice, slice], factor: tuple[int, int]
) -> Float[np.ndarray, "row column"]:
    """Return block means of a window of the file, read strip by strip so that files of any size work.

    A block is empty if less than half of it has data. Cells beyond the last whole block are dropped.
    """
    rows, columns = ((w.stop - w.start) // f for w, f in zip(window, factor, strict=True))
    means = np.full((rows, columns), np.nan)
    strip = max(1, STRIP_CELLS // (max(1, columns) * factor[0] * factor[1]))
    for first in range(0, rows, strip):
        count = min(strip, rows - first)
        height_m = _read(
            source,
            Window(window[1].start, window[0].start + first * factor[0], columns * factor[1], count * factor[0]),
        )
        blocks = height_m.reshape(count, factor[0], columns, factor[1])
        filled = np.isfinite(blocks)
        n = filled.sum(axis=(1, 3))
        total = np.where(filled, blocks, 0).sum(axis=(1, 3))
        enough = 2 * n >= factor[0] * factor[1]
        means[first : first + count][enough] = total[enough] / n[enough]
    return means


def _read(source: PlacedRaster, window: Window) -> Float[np.ndarray, "row column"]:
    """Return heights of the file in metres, NaN where it has no data, declared or not."""
    dataset = source.dataset
    stored = dataset.read(1, window=window, masked=True)
    undeclared = stored.data == UNDECLARED_NODATA
    with np.errstate(invalid="ignore"):  # a NaN that signals, in a damaged file
        height_m: Float[np.ndarray, "row column"] = stored.astype(np.float64).filled(np.nan)
    height_m = np.asarray((height_m * dataset.scales[0] + dataset.offsets[0]) * source.heights.unit_m)
    with np.errstate(invalid="ignore"):
        undeclared |= np.abs(height_m) > MAX_HEIGHT_M
    undeclared &= ~np.ma.getmaskarray(stored)
    if undeclared.any():
        logger.warning(
            "terrain: %d cells have impossible heights (such as %g) and are taken as empty; "
            "declare the file's nodata value with gdal_edit -a_nodata",
            undeclared.sum(),
            stored.data[undeclared][0],
        )
        height_m[undeclared] = np.nan
    return height_m


def bilinear(
    cells: Float[np.ndarray, "row column"], row: Float[np.ndarray, " n"], column: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return heights between cells, NaN outside them or where an empty one has weight."""
    filled = np.isfinite(cells)
    height_m = map_coordinates(np.where(filled, cells, 0), [row, column], order=1, cval=np.nan)
    weight = map_coordinates(filled.astype(np.float64), [row, column], order=1, cval=0.0)
    return np.asarray(np.where(weight > 1 - 1e-9, height_m, np.nan))
