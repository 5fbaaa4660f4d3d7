"""Detection of blunders in elevation rasters: single cells far above or below all of their neighbours.

A cell counts as one where it lies beyond all of its eight neighbours, above or below, by more than a steep slope over
a cell, and more than what stands on a single cell: trees, masts, chimneys and towers.
"""

import logging
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int
from pyproj import CRS
from scipy.ndimage import maximum_filter, minimum_filter

logger = logging.getLogger("sionna_radar")

# Slope to every neighbour, as a ratio (70 deg), and least height, m.
STEEPEST, TALLEST_M = float(np.tan(np.deg2rad(70.0))), 60.0
MAX_NAMED = 5
AROUND = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], dtype=bool)

# Coordinates of cells by row and column.
PlaceOf = Callable[[Int[np.ndarray, " cell"], Int[np.ndarray, " cell"]], Float[np.ndarray, "cell 2"]]


def lone_cells(height_m: Float[np.ndarray, "row column"], step_m: float) -> Int[np.ndarray, "cell 2"]:
    """Return rows and columns of the cells that lie far beyond all of their neighbours; empty ones do not count.

    height_m: NaN for an empty cell. step_m: distance of the cells.
    """
    if min(height_m.shape) < 3:
        return np.zeros((0, 2), dtype=np.int64)
    filled, beyond_m = np.isfinite(height_m), max(STEEPEST * step_m, TALLEST_M)
    highest = maximum_filter(np.where(filled, height_m, -np.inf), footprint=AROUND, mode="constant", cval=-np.inf)
    lowest = minimum_filter(np.where(filled, height_m, np.inf), footprint=AROUND, mode="constant", cval=np.inf)
    surrounded = filled & np.isfinite(highest)
    with np.errstate(invalid="ignore"):
        alone = surrounded & ((height_m - highest > beyond_m) | (lowest - height_m > beyond_m))
    return np.argwhere(alone)


def warn_of_lone_cells(
    height_m: Float[np.ndarray, "row column"], step_m: float, place: PlaceOf, crs: CRS | None
) -> None:
    """Warn of cells that lie far beyond all of their neighbours, named by place and height.

    height_m, step_m: as of `lone_cells`. place: coordinates of cells, in `crs` or local metres without one.
    """
    row, column = lone_cells(height_m, step_m).T
    if not len(row):
        return
    around_m, lone_m, place_m = float(np.nanmedian(height_m)), height_m[row, column], place(row, column)
    worst = np.argsort(-np.abs(lone_m - around_m))[:MAX_NAMED]
    named = "; ".join(f"{lone_m[cell]:.6g} m at ({place_m[cell, 0]:.10g}, {place_m[cell, 1]:.10g})" for cell in worst)
    more = f" and {len(lone_m) - MAX_NAMED} more" if len(lone_m) > MAX_NAMED else ""
    logger.warning(
        "terrain: %d single cell%s far beyond all neighbours, over ground at %.4g m: %s%s (%s); kept as the file says: "
        "correct the file if they are no towers or shafts",
        len(lone_m),
        "s lie" if len(lone_m) > 1 else " lies",
        around_m,
        named,
        more,
        "local metres" if crs is None else ":".join(crs.to_authority() or ("local",)),
    )
