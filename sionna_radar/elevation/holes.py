"""Cells of a terrain without data: kept as holes, filled from around them, or refused."""

import logging
from typing import Literal

import numpy as np
from jaxtyping import Bool
from rasterio.fill import fillnodata

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.raster import Raster

logger = logging.getLogger("sionna_radar")


def treat_holes(raster: Raster, holes: Literal["keep", "fill", "refuse"]) -> Raster:
    """Return a raster with its holes treated as asked.

    A hole is an empty cell that has data on both sides in its row or in its column; what lies beyond the border of the
    data is none. Filled heights are the mean of the data around a hole, weighted by the inverse distance (GDAL).

    Raises ScenarioError, for `terrain.holes`, where holes are refused and there are some.
    """
    if holes == "keep":
        return raster
    empty = between_data(raster.filled)
    count = int(np.count_nonzero(empty))
    if count == 0:
        return raster
    share = count / np.count_nonzero(raster.filled | empty)
    if holes == "refuse":
        row, column = np.argwhere(empty)[0]
        x, y = raster.grid.x_m[column], raster.grid.y_m[row]
        message = (
            f"'refuse' finds {count:,} cells without data ({share:.2%}), the first at ({x:.1f}, {y:.1f}) m; fill them "
            "in the file, move the flight, or set 'fill' or 'keep'"
        )
        raise ScenarioError([Problem("terrain.holes", message)])
    known = np.where(raster.filled, raster.height_m, 0.0).astype(np.float32)
    reach = float(max(raster.grid.shape))
    filled = fillnodata(known, mask=raster.filled, max_search_distance=reach, smoothing_iterations=0)
    logger.warning("terrain: %s cells without data (%.2f %%) are filled from around them", f"{count:,}", 100 * share)
    return Raster(grid=raster.grid, height_m=np.where(empty, filled.astype(np.float64), raster.height_m))


def between_data(filled: Bool[np.ndarray, "row column"]) -> Bool[np.ndarray, "row column"]:
    """Return the empty cells with data on both sides in their row or in their column."""
    inside = np.zeros(filled.shape, dtype=bool)
    for axis in (0, 1):
        before = np.logical_or.accumulate(filled, axis=axis)
        after = np.flip(np.logical_or.accumulate(np.flip(filled, axis), axis=axis), axis)
        inside |= before & after
    return inside & ~filled
