"""Which cells a survey lit: those of the main beam, the lines between two scans closed, shadows left out."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt

from sionna_radar.foundation.raster import Grid, Raster

Visible = Callable[[Float[np.ndarray, "ray 3"], Float[np.ndarray, "ray 3"]], Bool[np.ndarray, " ray"]]


class Illumination:
    """The cells that the main beam reached, gathered block by block, and where each was seen from."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._origin_m = np.full((*grid.shape, 3), np.nan)

    def add(self, hit_m: Float[np.ndarray, "hit 3"], origin_m: Float[np.ndarray, "hit 3"]) -> None:
        """Mark the cells under some hits of the main beam, sent from some places."""
        row, column, inside = self._grid.cell_of(hit_m)
        self._origin_m[row[inside], column[inside]] = origin_m[inside]

    def mask(self, gap_m: float, surface: Raster, visible: Visible) -> Bool[np.ndarray, "row column"]:
        """Return the lit cells with gaps narrower than `gap_m` closed: the lines between two scans.

        A gap that is hidden from where the nearest lit cell was seen is a shadow, and stays open.

        Parameters
        ----------
        gap_m:
            Widest gap between lit cells that counts as lit.
        surface:
            Heights of the cells, on the same grid.
        visible:
            Tells whether points are seen from origins.

        """
        lit = np.isfinite(self._origin_m[..., 0])
        gap = np.flatnonzero(closed(lit, gap_m, self._grid.spacing_m) & ~lit & surface.filled)
        if len(gap):
            nearest = distance_transform_edt(~lit, return_distances=False, return_indices=True)
            row, column = nearest.reshape(2, -1)[:, gap]
            point = np.column_stack([self._grid.centres_m[gap], surface.height_m.ravel()[gap]])
            lit.ravel()[gap] = visible(self._origin_m[row, column], point)
        return lit


def closed(cells: Bool[np.ndarray, "row column"], gap_m: float, spacing_m: float) -> Bool[np.ndarray, "row column"]:
    """Return some cells with the gaps between them closed that are narrower than `gap_m`.

    A closing by a disk of whole cells: what lies within its radius of a cell is taken, then what lies within it of a
    cell not taken is given back. By distances this costs the same whatever the radius.
    """
    reach = closing_cells(gap_m, spacing_m)
    if reach == 0 or not cells.any():
        return cells.copy()
    taken = distance_transform_edt(~np.pad(cells, reach)) <= reach
    # The corners of the border lie farther off than the radius, so that some cells are not taken.
    kept: Bool[np.ndarray, "row column"] = distance_transform_edt(taken) > reach
    return kept[reach : reach + cells.shape[0], reach : reach + cells.shape[1]]


def closing_cells(gap_m: float, spacing_m: float) -> int:
    """Return the radius, in cells, of the disk that closes a gap."""
    return int(np.ceil(gap_m / 2 / spacing_m))
