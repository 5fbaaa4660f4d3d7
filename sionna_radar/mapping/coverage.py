"""Illumination mask of a survey: cells in the main beam, with gaps between scan lines closed."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt

from sionna_radar.foundation.raster import Grid, Raster

Visible = Callable[[Float[np.ndarray, "ray 3"], Float[np.ndarray, "ray 3"]], Bool[np.ndarray, " ray"]]


class Illumination:
    """Cells reached by the main beam, collected block by block, with the position each was seen from."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self._origin_m = np.full((*grid.shape, 3), np.nan)
        self._new = np.zeros(grid.shape, dtype=np.bool_)

    @property
    def columns(self) -> tuple[Float[np.ndarray, "row column 3"], Bool[np.ndarray, "row column"]]:
        """Where each cell was last seen from, and whether it was since they were taken; for compiled code to write."""
        return self._origin_m, self._new

    def add(self, hit_m: Float[np.ndarray, "hit 3"], origin_m: Float[np.ndarray, "hit 3"]) -> None:
        """Mark the cells under hits of the main beam, seen from their origins."""
        row, column, inside = self.grid.cell_of(hit_m)
        self._origin_m[row[inside], column[inside]] = origin_m[inside]
        self._new[row[inside], column[inside]] = True

    def add_cells(self, cell: Int[np.ndarray, " lit"], origin_m: Float[np.ndarray, "lit 3"]) -> None:
        """Mark cells, by their number in the grid, seen from their origins; of several the last counts."""
        self._origin_m.reshape(-1, 3)[cell] = origin_m

    def taken(self) -> tuple[Int[np.ndarray, " lit"], Float[np.ndarray, "lit 3"]]:
        """Return the cells collected since the last call, by their numbers, and where each was last seen from."""
        cell = np.flatnonzero(self._new)
        self._new[:] = False
        return cell, self._origin_m.reshape(-1, 3)[cell]

    def mask(self, gap_m: float, surface: Raster, visible: Visible) -> Bool[np.ndarray, "row column"]:
        """Return the illuminated cells, with the gaps between scan lines closed if narrower than `gap_m`.

        A gap that is hidden from where the nearest illuminated cell was seen is a shadow, and stays open.

        gap_m: widest gap between illuminated cells that counts as illuminated.
        surface: heights of the cells, on the same grid.
        visible: returns whether points are visible from origins.
        """
        lit = np.isfinite(self._origin_m[..., 0])
        gap = np.flatnonzero(closed(lit, gap_m, self.grid.spacing_m) & ~lit & surface.filled)
        if len(gap):
            nearest = distance_transform_edt(~lit, return_distances=False, return_indices=True)
            row, column = nearest.reshape(2, -1)[:, gap]
            point = np.column_stack([self.grid.centres_m[gap], surface.height_m.ravel()[gap]])
            lit.ravel()[gap] = visible(self._origin_m[row, column], point)
        return lit


def closed(cells: Bool[np.ndarray, "row column"], gap_m: float, spacing_m: float) -> Bool[np.ndarray, "row column"]:
    """Return cells with the gaps between them closed that are narrower than `gap_m`.

    Morphological closing by a disk of whole cells: dilation by its radius, then erosion by as much. Computed by
    distance transforms, it costs the same whatever the radius.
    """
    reach = closing_cells(gap_m, spacing_m)
    if reach == 0 or not cells.any():
        return cells.copy()
    taken = distance_transform_edt(~np.pad(cells, reach)) <= reach
    # The corners of the border are farther off than the radius, so that some cells stay outside the dilation.
    kept: Bool[np.ndarray, "row column"] = distance_transform_edt(taken) > reach
    return kept[reach : reach + cells.shape[0], reach : reach + cells.shape[1]]


def closing_cells(gap_m: float, spacing_m: float) -> int:
    """Return the radius, in cells, of the disk that closes a gap."""
    return int(np.ceil(gap_m / 2 / spacing_m))
