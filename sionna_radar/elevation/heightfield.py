"""Gridded height field: bilinear heights, slopes and ray intersections."""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.raster import Grid


@dataclass(frozen=True, kw_only=True)
class Heightfield:
    """Heights of a grid without empty cells."""

    grid: Grid
    height_m: Float[np.ndarray, "row column"]

    def at(self, x_m: Float[np.ndarray, " n"], y_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return heights at horizontal positions."""
        corner, a, b = self._cell(x_m, y_m)
        z, columns = self.height_m.ravel(), self.grid.columns
        south = z[corner] * (1 - a) + z[corner + 1] * a
        north = z[corner + columns] * (1 - a) + z[corner + columns + 1] * a
        return south * (1 - b) + north * b

    def slope(
        self, x_m: Float[np.ndarray, " n"], y_m: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return the slopes toward east and north."""
        corner, a, b = self._cell(x_m, y_m)
        z, columns = self.height_m.ravel(), self.grid.columns
        sw, se, nw, ne = (z[corner + k] for k in (0, 1, columns, columns + 1))
        east = (se - sw) * (1 - b) + (ne - nw) * b
        north = (nw - sw) * (1 - a) + (ne - se) * a
        return east / self.grid.spacing_m, north / self.grid.spacing_m

    def weights(self, x_m: Float[np.ndarray, " n"], y_m: Float[np.ndarray, " n"]) -> csr_matrix:
        """Return the matrix that interpolates the heights of the cells at horizontal positions."""
        corner, a, b = self._cell(x_m, y_m)
        columns = self.grid.columns
        cells = np.stack([corner, corner + 1, corner + columns, corner + columns + 1], axis=1)
        corner_weights = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], axis=1)
        indptr = np.arange(len(x_m) + 1) * 4
        return csr_matrix((corner_weights.ravel(), cells.ravel(), indptr), shape=(len(x_m), self.height_m.size))

    def first_hit(
        self, origin_m: Float[np.ndarray, "ray 3"], direction: Float[np.ndarray, "ray 3"], reach_m: float
    ) -> Float[np.ndarray, " ray"]:
        """Return the ranges at which rays along unit vectors first hit the surface; NaN if not within reach.

        Each ray advances by its height above the surface over the fastest possible closing rate, at least by
        a quarter of a cell, which is the width of the smallest feature found.
        """
        origin, direction = np.ascontiguousarray(origin_m), np.ascontiguousarray(direction)
        grid, height = self.grid, np.ascontiguousarray(self.height_m)
        bounds = self.steepest, float(height.max())
        return first_hits(height, grid.west_m, grid.south_m, grid.spacing_m, origin, direction, float(reach_m), *bounds)

    @property
    def steepest(self) -> float:
        """Bound on the slope, with a margin, for rays that march toward the surface."""
        east, north = np.gradient(self.height_m, self.grid.spacing_m, axis=(1, 0))
        return float(np.hypot(east, north).max()) + 0.05

    def _cell(
        self, x_m: Float[np.ndarray, " n"], y_m: Float[np.ndarray, " n"]
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        grid = self.grid
        column = np.clip((x_m - grid.west_m) / grid.spacing_m, 0, grid.columns - 1.001)
        row = np.clip((y_m - grid.south_m) / grid.spacing_m, 0, grid.rows - 1.001)
        west, south = column.astype(np.int64), row.astype(np.int64)
        return south * grid.columns + west, column - west, row - south


MARCH_STEPS = 1000
# Near machine precision, so that hits vary smoothly with the surface.
ROOT_STEPS = 60
CLOSE_M = 1e-12
# Newton's method converges in few steps for a slightly moved surface, unless the ray is nearly parallel to it.
NEWTON_STEPS, MIN_CLOSING = 8, -0.1


@compiled
@no_type_check
def corner_of(x, y, west, south, spacing, rows, columns):
    """Return row and column of the cell south-west of a position, and the offsets from there, in cells."""
    column = min(max((x - west) / spacing, 0.0), columns - 1.001)
    row = min(max((y - south) / spacing, 0.0), rows - 1.001)
    j, i = int(column), int(row)
    return i, j, row - i, column - j


@compiled
@no_type_check
def height_at(height, west, south, spacing, x, y):
    """Return the height at a position."""
    i, j, b, a = corner_of(x, y, west, south, spacing, height.shape[0], height.shape[1])
    south_m = height[i, j] * (1 - a) + height[i, j + 1] * a
    north_m = height[i + 1, j] * (1 - a) + height[i + 1, j + 1] * a
    return south_m * (1 - b) + north_m * b


@compiled
@no_type_check
def slope_at(height, west, south, spacing, x, y):
    """Return the slopes toward east and north at a position."""
    i, j, b, a = corner_of(x, y, west, south, spacing, height.shape[0], height.shape[1])
    sw, se, nw, ne = height[i, j], height[i, j + 1], height[i + 1, j], height[i + 1, j + 1]
    east = (se - sw) * (1 - b) + (ne - nw) * b
    north = (nw - sw) * (1 - a) + (ne - se) * a
    return east / spacing, north / spacing


@compiled
@no_type_check
def _gap(height, west, south, spacing, origin, direction, reached):
    x, y = origin[0] + reached * direction[0], origin[1] + reached * direction[1]
    return origin[2] + reached * direction[2] - height_at(height, west, south, spacing, x, y)


@compiled
@no_type_check
def _crossing(height, west, south, spacing, origin, direction, low, high):
    """Return the range at which a ray crosses the surface between two ranges, by the Illinois false-position method."""
    low_gap = _gap(height, west, south, spacing, origin, direction, low)
    high_gap = _gap(height, west, south, spacing, origin, direction, high)
    # Below the surface from the start, as under an overhang of the map: return the far end, as bisection would.
    if low >= high or low_gap <= 0.0:
        return low
    side, middle = 0, high
    for _ in range(ROOT_STEPS):
        middle = high - high_gap * (high - low) / (high_gap - low_gap)
        if not low < middle < high:
            break
        gap = _gap(height, west, south, spacing, origin, direction, middle)
        if abs(gap) < CLOSE_M:
            break
        if gap < 0.0:
            low_gap = low_gap / 2 if side < 0 else low_gap
            high, high_gap, side = middle, gap, -1
        else:
            high_gap = high_gap / 2 if side > 0 else high_gap
            low, low_gap, side = middle, gap, 1
    return middle


@compiled
@no_type_check
def first_hit(height, west, south, spacing, origin, direction, reach, steepest, highest):
    """Return the range at which one ray first meets the surface, NaN if not within reach.

    steepest, highest: slope and height of the surface, which bound the closing rate and the first possible hit.
    """
    closing = abs(direction[2]) + steepest * np.hypot(direction[0], direction[1])
    reached = min(max((origin[2] - highest) / max(-direction[2], 1e-6), 0.0), reach)
    before = reached
    for _ in range(MARCH_STEPS):
        gap = _gap(height, west, south, spacing, origin, direction, reached)
        if gap <= 0.0:
            return _crossing(height, west, south, spacing, origin, direction, min(before, reached), reached)
        if reached >= reach:
            break
        before = reached
        reached += max(gap / closing, spacing / 4)
    return np.nan


@compiled
@no_type_check
def hit_near(height, west, south, spacing, origin, direction, guess):
    """Return the range near a guess at which a ray meets the surface, by Newton's method; NaN without convergence."""
    reached = guess
    for _ in range(NEWTON_STEPS):
        x, y = origin[0] + reached * direction[0], origin[1] + reached * direction[1]
        i, j, b, a = corner_of(x, y, west, south, spacing, height.shape[0], height.shape[1])
        sw, se, nw, ne = height[i, j], height[i, j + 1], height[i + 1, j], height[i + 1, j + 1]
        south_m, north_m = sw + (se - sw) * a, nw + (ne - nw) * a
        gap = origin[2] + reached * direction[2] - south_m - (north_m - south_m) * b
        if abs(gap) < CLOSE_M:
            return reached
        east, north = (se - sw) * (1 - b) + (ne - nw) * b, north_m - south_m
        closing = direction[2] - (east * direction[0] + north * direction[1]) / spacing
        # A ray nearly parallel to the surface: its first hit needs a search from its origin.
        if closing > MIN_CLOSING:
            return np.nan
        reached -= gap / closing
        if abs(reached - guess) > spacing:
            return np.nan
    return np.nan


@compiled
@no_type_check
def first_hits(height, west, south, spacing, origin, direction, reach, steepest, highest):
    """Return the ranges at which rays first meet the surface: (ray, 3) and (ray, 3) to (ray)."""
    hit = np.empty(len(origin))
    for ray in range(len(origin)):
        hit[ray] = first_hit(height, west, south, spacing, origin[ray], direction[ray], reach, steepest, highest)
    return hit
