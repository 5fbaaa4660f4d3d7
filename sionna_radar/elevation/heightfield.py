"""A surface by its heights on a grid: bilinear between the cells, constant beyond the border."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix

from sionna_radar.foundation.raster import Grid


@dataclass(frozen=True, kw_only=True)
class Heightfield:
    """Heights of all cells of a grid; none is empty."""

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
        shares = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], axis=1)
        indptr = np.arange(len(x_m) + 1) * 4
        return csr_matrix((shares.ravel(), cells.ravel(), indptr), shape=(len(x_m), self.height_m.size))

    def first_hit(
        self, origin_m: Float[np.ndarray, "ray 3"], direction: Float[np.ndarray, "ray 3"], reach_m: float
    ) -> Float[np.ndarray, " ray"]:
        """Return the ranges at which rays along unit vectors first hit the surface; NaN if not within reach.

        Each ray advances by its height above the surface over the fastest rate at which they can close, at least by
        a quarter of a cell, so that it misses nothing wider than that.
        """
        from sionna_radar.elevation.ray_march import first_hits

        origin, direction = np.ascontiguousarray(origin_m), np.ascontiguousarray(direction)
        grid, height = self.grid, np.ascontiguousarray(self.height_m)
        bounds = self.steepest, float(height.max())
        hit: Float[np.ndarray, " ray"] = first_hits(
            height, grid.west_m, grid.south_m, grid.spacing_m, origin, direction, float(reach_m), *bounds
        )
        return hit

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
