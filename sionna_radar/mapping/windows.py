"""A grid cut into windows that hold few points each, so that maps of long surveys take no more memory than short ones.

A window depends on the grid and the points alone, never on who works on it.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.foundation.raster import Grid


@dataclass(frozen=True)
class Window:
    """Some rows and columns of a grid."""

    grid: Grid
    rows: slice
    columns: slice

    @property
    def low_m(self) -> Float[np.ndarray, "2"]:
        """Centre of its first cell."""
        return np.array([self.grid.x_m[self.columns.start], self.grid.y_m[self.rows.start]])

    @property
    def high_m(self) -> Float[np.ndarray, "2"]:
        """Centre of its last cell."""
        return np.array([self.grid.x_m[self.columns.stop - 1], self.grid.y_m[self.rows.stop - 1]])

    def around(self, place_m: Float[np.ndarray, "n 2"], reach_m: float) -> Bool[np.ndarray, " n"]:
        """Return which places are no farther than that from its cells, along each axis."""
        return np.all((place_m >= self.low_m - reach_m) & (place_m <= self.high_m + reach_m), axis=1)


def windows_of(grid: Grid, place_m: Float[np.ndarray, "n 2"], most: int, least_m: float) -> list[Window]:
    """Return windows that together are the grid, each with about as many points as the others.

    Parameters
    ----------
    grid:
        The grid.
    place_m:
        The points; those beyond the grid count in the windows at its edge.
    most:
        Points of a window, unless it would become narrower than
    least_m:
        its least width and height.

    """
    cell = np.floor((place_m - [grid.west_m, grid.south_m]) / grid.spacing_m + 0.5).astype(np.int64)
    least = max(1, int(np.ceil(least_m / grid.spacing_m)))
    return list(_halves(Window(grid, slice(0, grid.rows), slice(0, grid.columns)), cell, most, least))


def _halves(window: Window, cell: np.ndarray, most: int, least: int) -> Iterator[Window]:
    """Yield the parts of a window, halved across its longer side as long as they hold too many points."""
    sides = window.columns, window.rows
    lengths = [side.stop - side.start for side in sides]
    axis = int(lengths[1] > lengths[0])
    if len(cell) <= most or lengths[axis] < 2 * least:
        yield window
        return
    side = sides[axis]
    middle = int(np.clip(np.median(cell[:, axis]), side.start + least, side.stop - least))
    below = cell[:, axis] < middle
    for part, inside in ((slice(side.start, middle), below), (slice(middle, side.stop), ~below)):
        columns, rows = (part, sides[1]) if axis == 0 else (sides[0], part)
        yield from _halves(Window(window.grid, rows, columns), cell[inside], most, least)
