"""Resampling of an elevation file to a grid, treatment of its holes, and seeded fractal detail below its spacing.

The cells are interpolated from the file one by one (bilinear between its cell centres, after averaging if the file is
finer), not warped by GDAL, whose approximate transformer and half-cell extrapolation at edges and voids would cost
accuracy.

Cells without data are kept as holes, filled from their surroundings, or rejected.

Seeded detail below the spacing of the file models a surface that is not smooth between its posts. The detail is a
Gaussian surface whose power spectrum falls as k^-(2 H + 2), as that of natural terrain (a self-affine surface of Hurst
exponent H; Turcotte 1997, "Fractals and Chaos in Geology and Geophysics", ch. 7), at wavelengths below two posts of
the file, which leaves the file's own spectrum unchanged. It depends only on the place and the seed, not on the cropped
window.
"""

import logging
import math
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import map_coordinates

from sionna_radar.elevation.placed_raster import PlacedRaster, apply_affine
from sionna_radar.elevation.wrong_cells import warn_of_lone_cells
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.foundation.raster_band import UNDECLARED_NODATA, band_values

logger = logging.getLogger("sionna_radar")

# Largest number of the file's cells in memory.
STRIP_CELLS = 4_000_000
# Beyond any height on Earth: a stand-in for "no data" that the file does not declare.
MAX_HEIGHT_M = 12_000.0


def heights_on(source: PlacedRaster, grid: Grid) -> Float[np.ndarray, "row column"]:
    """Return bilinear heights at the grid's centres; NaN next to a cell without data."""
    column, row = source.pixel_of(*grid.centres_m.T)
    # Snap to cell centres, so that rounding does not involve a neighbouring cell.
    column, row = (np.where(np.abs(c - np.rint(c)) < 1e-6, np.rint(c), c) for c in (column, row))
    rows, columns = source.dataset.shape
    inside = (column >= 0) & (column <= columns - 1) & (row >= 0) & (row <= rows - 1)
    height_m = np.full(grid.columns * grid.rows, np.nan)
    if inside.any():
        lookup = row[inside], column[inside]
        # Number of whole file cells per target cell, which are averaged.
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
    start = max(0, (int(coordinate.min()) // factor - 1) * factor)
    return slice(start, min(cells, (int(coordinate.max()) // factor + 2) * factor))


def _averaged(
    source: PlacedRaster, window: tuple[slice, slice], factor: tuple[int, int]
) -> Float[np.ndarray, "row column"]:
    """Return block means of a window of the file, read in strips that bound the memory.

    A block is empty if less than half of it has data. Cells beyond the last whole block are dropped.
    """
    rows, columns = ((w.stop - w.start) // f for w, f in zip(window, factor, strict=True))
    means = np.full((rows, columns), np.nan)
    strip = max(1, STRIP_CELLS // (max(1, columns) * factor[0] * factor[1]))
    for start in range(0, rows, strip):
        count = min(strip, rows - start)
        top, left = window[0].start + start * factor[0], window[1].start
        height_m = _read(source, (top, top + count * factor[0]), (left, left + columns * factor[1]))
        blocks = height_m.reshape(count, factor[0], columns, factor[1])
        filled = np.isfinite(blocks)
        n = filled.sum(axis=(1, 3))
        total = np.where(filled, blocks, 0).sum(axis=(1, 3))
        half_filled = 2 * n >= factor[0] * factor[1]
        means[start : start + count][half_filled] = total[half_filled] / n[half_filled]
    return means


def _read(source: PlacedRaster, rows: tuple[int, int], columns: tuple[int, int]) -> Float[np.ndarray, "row column"]:
    """Return heights of the file in metres, NaN where it has no data, declared or not.

    rows, columns: the first, and the last plus one.
    """
    dataset = source.dataset
    stored = dataset.read(source.band, window=(rows, columns), masked=True)
    undeclared = stored.data == UNDECLARED_NODATA
    height_m = band_values(dataset, stored, source.band) * source.heights.unit_m
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

    def place(row: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        pixel = column + columns[0] + 0.5, row + rows[0] + 0.5
        return np.column_stack(apply_affine(source.dataset.transform, *pixel))

    warn_of_lone_cells(height_m, min(source.steps_m), place, source.crs)
    return height_m


def bilinear(
    cells: Float[np.ndarray, "row column"], row: Float[np.ndarray, " n"], column: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return bilinear heights, NaN outside the cells or where an empty cell has weight."""
    filled = np.isfinite(cells)
    height_m = map_coordinates(np.where(filled, cells, 0), [row, column], order=1, cval=np.nan)
    weight = map_coordinates(filled.astype(np.float64), [row, column], order=1, cval=0.0)
    return np.asarray(np.where(weight > 1 - 1e-9, height_m, np.nan))


def treat_holes(raster: Raster, holes: Literal["keep", "fill", "refuse"]) -> Raster:
    """Return a raster with its holes kept, filled or rejected.

    A hole is an empty cell with data on both sides in its row or in its column; empty cells beyond the border of the
    data are not holes. Filled heights are the mean of the data around a hole, weighted by the inverse distance (GDAL).

    Raises ScenarioError, for `terrain.holes`, for holes with "refuse".
    """
    if holes == "keep":
        return raster
    empty = between_data(raster.filled)
    count = int(np.count_nonzero(empty))
    if count == 0:
        return raster
    fraction = count / np.count_nonzero(raster.filled | empty)
    if holes == "refuse":
        row, column = np.argwhere(empty)[0]
        x, y = raster.grid.x_m[column], raster.grid.y_m[row]
        message = (
            f"'refuse' finds {count:,} cells without data ({fraction:.2%}), the first at ({x:.1f}, {y:.1f}) m; fill "
            "them "
            "in the file, move the flight, or set 'fill' or 'keep'"
        )
        raise ScenarioError.of("terrain.holes", message)
    # rasterio, which nothing but a file needs, takes long to import.
    from rasterio.fill import fillnodata

    heights = np.where(raster.filled, raster.height_m, 0.0).astype(np.float32)
    reach = float(max(raster.grid.shape))
    filled = fillnodata(heights, mask=raster.filled, max_search_distance=reach, smoothing_iterations=0)
    logger.warning("terrain: %s cells without data (%.2f %%) are filled from around them", f"{count:,}", 100 * fraction)
    return Raster(grid=raster.grid, height_m=np.where(empty, filled.astype(np.float64), raster.height_m))


def between_data(filled: Bool[np.ndarray, "row column"]) -> Bool[np.ndarray, "row column"]:
    """Return the empty cells with data on both sides in their row or in their column."""
    enclosed = np.zeros(filled.shape, dtype=bool)
    for axis in (0, 1):
        before = np.logical_or.accumulate(filled, axis=axis)
        after = np.flip(np.logical_or.accumulate(np.flip(filled, axis), axis=axis), axis)
        enclosed |= before & after
    return enclosed & ~filled


# Edge length, in cells, of the tiles of white noise; each has its own generator.
TILE = 256
# Half width of the shaping kernel in posts of the file: less than 2e-5 of its energy lies beyond (computed for
# Hurst exponents of 0.2 to 0.95 and 2 to 20 cells per post).
REACH_POSTS, MAX_REACH = 6, 384


def detail_on(grid: Grid, post_m: float, hurst: float, rms_m: float, seed: int) -> Float[np.ndarray, "row column"]:
    """Return heights of the detail on a grid, of zero mean.

    grid: the cells; a whole multiple of their spacing leads from one grid to another with the same detail.
    post_m: spacing of the file: there is no detail at wavelengths above twice this.
    hurst, rms_m: exponent, and root mean square of the detail.
    seed: of the detail.

    Raises ScenarioError if the grid is too coarse for any detail.
    """
    if grid.spacing_m > post_m / 2:
        message = (
            f"cells of {grid.spacing_m:g} m have no room for detail below the file's {post_m:.3g} m; set "
            f"terrain.spacing_m = {post_m / 4:.2g} or less"
        )
        raise ScenarioError.of("terrain.roughen", message)
    kernel = _kernel(grid.spacing_m / post_m, hurst)
    reach = len(kernel) // 2
    # Cells are counted from the map's origin, so that neighbouring windows agree.
    column, row = (round(edge / grid.spacing_m) for edge in (grid.west_m, grid.south_m))
    noise = _noise(row - reach, column - reach, grid.rows + 2 * reach, grid.columns + 2 * reach, seed)
    # Slow to import.
    from scipy.signal import fftconvolve

    shaped: Float[np.ndarray, "row column"] = fftconvolve(noise, kernel, mode="valid")
    return rms_m * shaped


def _kernel(cells_per_post: float, hurst: float) -> Float[np.ndarray, "k k"]:
    """Return the kernel that filters white noise of unit variance into detail of unit variance."""
    reach = min(MAX_REACH, int(np.ceil(REACH_POSTS / cells_per_post)))
    size = 2 * reach + 1
    wavenumber = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)[None])  # cycles per cell
    lowest = cells_per_post / 2
    with np.errstate(divide="ignore"):
        spectrum = np.where(wavenumber >= lowest, wavenumber ** -(hurst + 1), 0.0)
    # A sharp edge in the spectrum would ring far beyond the kernel.
    rise = np.clip(wavenumber / lowest - 1, 0.0, 1.0)
    spectrum *= np.sin(np.pi / 2 * rise) ** 2
    kernel = np.fft.fftshift(np.fft.ifft2(spectrum).real)
    taper = np.hanning(size + 2)[1:-1]
    kernel = kernel * np.outer(taper, taper)
    return kernel / np.sqrt((kernel**2).sum())


def _noise(row: int, column: int, rows: int, columns: int, seed: int) -> Float[np.ndarray, "row column"]:
    """Return white noise at cells of an infinite plane, from the tiles that contain them."""
    first_tile, last_tile = (row // TILE, column // TILE), ((row + rows - 1) // TILE, (column + columns - 1) // TILE)
    tiles = np.empty(
        ((last_tile[0] - first_tile[0] + 1) * TILE, (last_tile[1] - first_tile[1] + 1) * TILE), dtype=np.float32
    )
    for i in range(first_tile[0], last_tile[0] + 1):
        for j in range(first_tile[1], last_tile[1] + 1):
            generator = np.random.default_rng([seed, i + 2**31, j + 2**31])
            corner = (i - first_tile[0]) * TILE, (j - first_tile[1]) * TILE
            tiles[corner[0] : corner[0] + TILE, corner[1] : corner[1] + TILE] = generator.standard_normal(
                (TILE, TILE), dtype=np.float32
            )
    top, left = row - first_tile[0] * TILE, column - first_tile[1] * TILE
    return tiles[top : top + rows, left : left + columns].astype(np.float64)
