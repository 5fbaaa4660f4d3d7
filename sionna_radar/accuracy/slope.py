"""Slopes of a raster by the third-order finite differences of Horn (1981), as GDAL and xDEM have them."""

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.raster import Raster


def gradient(raster: Raster) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
    """Return the slopes toward east and north, as ratios; NaN at the border and next to empty cells.

    From the three differences on both sides of a cell, the middle ones counted twice (Horn 1981, "Hill shading and the
    reflectance map", Proceedings of the IEEE 69, 14-47).
    """
    z, width = raster.height_m, 8 * raster.grid.spacing_m
    east, north = np.full(z.shape, np.nan), np.full(z.shape, np.nan)
    if min(z.shape) < 3:
        return east, north
    along = z[:, 2:] - z[:, :-2]
    east[1:-1, 1:-1] = (along[:-2] + 2 * along[1:-1] + along[2:]) / width
    across = z[2:] - z[:-2]
    north[1:-1, 1:-1] = (across[:, :-2] + 2 * across[:, 1:-1] + across[:, 2:]) / width
    return east, north


def slope_deg(raster: Raster) -> Float[np.ndarray, "row column"]:
    """Return the slope of each cell in degrees; NaN as for `gradient`."""
    return np.rad2deg(np.arctan(np.hypot(*gradient(raster))))
