"""Which cells a survey lit, to hold the mapped ones against."""

import numpy as np
from jaxtyping import Bool
from scipy.ndimage import binary_closing

from sionna_radar.raster import Grid
from sionna_radar.tracing.paths import Paths

# A path counts as lit by the main beam within this share of its pulse's strongest path.
MAIN_BEAM_SHARE = 0.25


class Illumination:
    """The cells that the main beam reached, gathered block by block."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._lit = np.zeros(grid.shape, dtype=bool)

    def add(self, paths: Paths) -> None:
        """Mark the cells that a block of paths hit with the main beam."""
        if len(paths) == 0:
            return
        power = (paths.gain.real**2 + paths.gain.imag**2) * (paths.surface >= 0)
        first = np.flatnonzero(np.diff(paths.pulse, prepend=paths.pulse[0] - 1))
        count = np.diff(first, append=len(paths))
        strongest = np.repeat(np.maximum.reduceat(power, first), count)
        hit = paths.hit_m[power > MAIN_BEAM_SHARE * strongest]
        grid = self._grid
        column = np.round((hit[:, 0] - grid.west_m) / grid.spacing_m).astype(np.int64)
        row = np.round((hit[:, 1] - grid.south_m) / grid.spacing_m).astype(np.int64)
        inside = (column >= 0) & (column < grid.columns) & (row >= 0) & (row < grid.rows)
        self._lit[row[inside], column[inside]] = True

    def mask(self, gap_m: float) -> Bool[np.ndarray, "row column"]:
        """Return the lit cells with gaps narrower than `gap_m` closed: the lines between two scans."""
        reach = int(np.ceil(gap_m / 2 / self._grid.spacing_m))
        offset = np.arange(-reach, reach + 1)
        disk = offset[:, None] ** 2 + offset[None] ** 2 <= reach**2
        padded = np.pad(self._lit, reach)
        closed = binary_closing(padded, disk)
        return closed[reach : closed.shape[0] - reach, reach : closed.shape[1] - reach]
