"""Two-way power of an arbitrary antenna on a grid of direction cosines.

The cells are narrow where the power is high, so that a pencil beam, its side lobes and a grating lobe far off the axis
are all resolved: half of the edges divide the power into equal shares, the others are equally spaced.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

Relative = Callable[[Float[np.ndarray, "k 3"]], Float[np.ndarray, " k"]]

# Edges of either kind along each axis.
EDGES = 200
# Bounds on the samples along each axis that locate the power, one per step of the pattern.
MIN_SEARCHED, MAX_SEARCHED = 400, 2000
# Cells at the rim of the half sphere have no bound on their solid angle.
MIN_COSINE = 0.02
CELLS_AT_ONCE = 50_000


@dataclass(frozen=True, kw_only=True)
class TwoWayGrid:
    """Cells of direction cosines (left, up) in front of an antenna.

    left, up: edges of the cells, from -1 to 1, in the frame of the face.
    power_sr: integral of the two-way gain over the peak's in each cell, in steradians.
    R_face_antenna: rotation from the antenna's frame to that of its radiating face; they differ for a steered array.
    """

    left: Float[np.ndarray, " column_edge"]
    up: Float[np.ndarray, " row_edge"]
    power_sr: Float[np.ndarray, "row column"]
    R_face_antenna: Float[np.ndarray, "3 3"]

    @property
    def beam_sr(self) -> float:
        """Integral over all cells."""
        return float(self.power_sr.sum())

    @cached_property
    def direction(self) -> Float[np.ndarray, "cell 3"]:
        """Unit vectors of the centres of the cells in the antenna's frame, row by row."""
        face = _directions((self.left[1:] + self.left[:-1]) / 2, (self.up[1:] + self.up[:-1]) / 2)
        return face @ self.R_face_antenna

    def reach(self, outside: float) -> tuple[float, float]:
        """Return half extents (left, up) in direction cosines that contain all but a fraction of the forward power."""
        ahead = self.direction[:, 0] > 0
        reaches, power = [], self.power_sr.ravel()[ahead]
        for axis in (1, 2):
            offset = np.abs(self.direction[ahead, axis])
            order = np.argsort(offset)
            cumulative = np.cumsum(power[order])
            reaches.append(float(offset[order][np.searchsorted(cumulative, (1 - outside) * cumulative[-1])]))
        return reaches[0], reaches[1]


def two_way_grid(gain: Relative, step_rad: float, R_face_antenna: Float[np.ndarray, "3 3"]) -> TwoWayGrid:
    """Return the two-way power of an antenna.

    gain: its one-way gain over the peak's toward unit vectors in the antenna's frame; the square is the two-way gain.
    step_rad: angle within which it hardly changes.
    R_face_antenna: see `TwoWayGrid`.
    """
    count = int(np.clip(2 / step_rad, MIN_SEARCHED, MAX_SEARCHED))
    centre, width = (np.arange(count) + 0.5) * (2 / count) - 1, np.full(count, 2 / count)

    def facing(direction: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        return gain(direction @ R_face_antenna)

    coarse_power = _power(facing, centre, centre, width, width)
    left, up = (_edges(coarse_power.sum(axis=axis), count) for axis in (0, 1))
    centres = (left[1:] + left[:-1]) / 2, (up[1:] + up[:-1]) / 2
    return TwoWayGrid(
        left=left,
        up=up,
        power_sr=_power(facing, *centres, np.diff(left), np.diff(up)),
        R_face_antenna=R_face_antenna,
    )


def _edges(power: Float[np.ndarray, " n"], count: int) -> Float[np.ndarray, " edge"]:
    cumulative = np.concatenate([[0.0], np.cumsum(power)])
    equal_power = np.interp(np.linspace(0, 1, EDGES + 1), cumulative / cumulative[-1], np.linspace(-1, 1, count + 1))
    # The same number for every antenna, so that all beams power one compiled kernel; some cells have zero width.
    return np.sort(np.concatenate([equal_power[1:-1], np.linspace(-1.0, 1.0, EDGES + 1)]))


def _power(
    gain: Relative,
    left: Float[np.ndarray, " column"],
    up: Float[np.ndarray, " row"],
    width: Float[np.ndarray, " column"],
    height: Float[np.ndarray, " row"],
) -> Float[np.ndarray, "row column"]:
    """Return the integral of the relative two-way gain over cells, by their midpoints; dOmega = du dv / cos."""
    power = np.zeros((len(up), len(left)))
    step = max(1, CELLS_AT_ONCE // len(left))
    for start in range(0, len(up), step):
        rows = slice(start, start + step)
        direction = _directions(left, up[rows])
        visible = direction[:, 0] > MIN_COSINE
        density = np.zeros(len(direction))
        density[visible] = gain(direction[visible]) ** 2 / direction[visible, 0]
        power[rows] = density.reshape(-1, len(left)) * np.outer(height[rows], width)
    return power


def toward(left: Float[np.ndarray, " n"], up: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """Return unit vectors (boresight, left, up) of direction cosines; longer ones where there is no such direction."""
    return np.column_stack([np.sqrt(np.maximum(1 - left**2 - up**2, 0.0)), left, up])


def _directions(left: Float[np.ndarray, " column"], up: Float[np.ndarray, " row"]) -> Float[np.ndarray, "cell 3"]:
    return toward(*(grid.ravel() for grid in np.meshgrid(left, up)))
