"""Which cells a survey lit: those of the main beam, the lines between two scans closed, shadows left out."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_closing, distance_transform_edt

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.raster import Grid, Raster
from sionna_radar.tracing.paths import Paths

# The main beam is where its one-way power is at least half of the peak's, so its two-way power a quarter.
MAIN_BEAM_SHARE = 0.25

Visible = Callable[[Float[np.ndarray, "ray 3"], Float[np.ndarray, "ray 3"]], Bool[np.ndarray, " ray"]]


class Illumination:
    """The cells that the main beam reached, gathered block by block, and where each was seen from."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._origin_m = np.full((*grid.shape, 3), np.nan)

    def add(self, hit_m: Float[np.ndarray, "hit 3"], origin_m: Float[np.ndarray, "hit 3"]) -> None:
        """Mark the cells under some hits of the main beam, sent from some places."""
        grid = self._grid
        column = np.round((hit_m[:, 0] - grid.west_m) / grid.spacing_m).astype(np.int64)
        row = np.round((hit_m[:, 1] - grid.south_m) / grid.spacing_m).astype(np.int64)
        inside = (column >= 0) & (column < grid.columns) & (row >= 0) & (row < grid.rows)
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
        reach = int(np.ceil(gap_m / 2 / self._grid.spacing_m))
        offset = np.arange(-reach, reach + 1)
        disk = offset[:, None] ** 2 + offset[None] ** 2 <= reach**2
        padded = np.pad(lit, reach)
        closed = binary_closing(padded, disk)[reach : reach + lit.shape[0], reach : reach + lit.shape[1]]
        gap = np.flatnonzero(closed & ~lit & surface.filled)
        if len(gap):
            nearest = distance_transform_edt(~lit, return_distances=False, return_indices=True)
            row, column = nearest.reshape(2, -1)[:, gap]
            point = np.column_stack([self._grid.centres_m[gap], surface.height_m.ravel()[gap]])
            lit.ravel()[gap] = visible(self._origin_m[row, column], point)
        return lit


def main_beam_hits(
    paths: Paths, pulses: Pulses, antenna: Antenna
) -> tuple[Float[np.ndarray, "hit 3"], Float[np.ndarray, "hit 3"]]:
    """Return where a block of paths met surfaces inside the main beam, and where the radar truly was."""
    pose = pulses.true
    row = np.searchsorted(pulses.index, paths.pulse)
    away = paths.hit_m - pose.position_m[row]
    away = away / np.linalg.norm(away, axis=1, keepdims=True)
    gain = antenna.gain(np.einsum("nij,ni->nj", pose.R_world_antenna[row], away))
    inside = (gain**2 >= MAIN_BEAM_SHARE * antenna.peak_gain**2) & (paths.surface >= 0)
    return paths.hit_m[inside], pose.position_m[row[inside]]
