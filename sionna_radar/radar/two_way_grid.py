"""The two-way power of any antenna, on cells of direction cosines in front of it.

The cells are narrow where the power is, so that a pencil beam, its side lobes and a grating lobe far off the axis are
all resolved: half of the edges divide the power into equal shares, the others are equally spaced.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

Relative = Callable[[Float[np.ndarray, "k 3"]], Float[np.ndarray, " k"]]

# Edges of either kind along each axis.
EDGES = 200
# Samples along each axis that find where the power is: one for a step of the pattern, but no fewer and no more.
MIN_SEARCHED, MAX_SEARCHED = 400, 2000
# Cells at the rim of the half sphere have no bound on their solid angle.
MIN_COSINE = 0.02
CELLS_AT_ONCE = 50_000


@dataclass(frozen=True, kw_only=True)
class TwoWayGrid:
    """Cells of direction cosines (left, up) in front of an antenna.

    left, up: edges of the cells, from -1 to 1, in the frame of the face.
    power_sr: integral of the two-way gain over the peak's in each cell, in steradians.
    R_face_antenna: turns components in the antenna's frame into those in the frame of the face from which it radiates,
        which differ for a steered array.
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
        """Return the direction cosines to the left and up, on either side, with all but a share of the power ahead."""
        ahead = self.direction[:, 0] > 0
        found, power = [], self.power_sr.ravel()[ahead]
        for axis in (1, 2):
            away = np.abs(self.direction[ahead, axis])
            order = np.argsort(away)
            below = np.cumsum(power[order])
            found.append(float(away[order][np.searchsorted(below, (1 - outside) * below[-1])]))
        return found[0], found[1]


def two_way_grid(gain: Relative, step_rad: float, R_face_antenna: Float[np.ndarray, "3 3"]) -> TwoWayGrid:
    """Return the two-way power of an antenna.

    Parameters
    ----------
    gain:
        Its one-way gain over the peak's toward unit vectors in the antenna's frame; the square is the two-way gain.
    step_rad:
        Angle within which it hardly changes.
    R_face_antenna:
        See `TwoWayGrid`.

    """
    count = int(np.clip(2 / step_rad, MIN_SEARCHED, MAX_SEARCHED))
    place, width = (np.arange(count) + 0.5) * (2 / count) - 1, np.full(count, 2 / count)

    def facing(direction: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        return gain(direction @ R_face_antenna)

    found = _power(facing, place, place, width, width)
    left, up = (_edges(found.sum(axis=axis), count) for axis in (0, 1))
    centres = (left[1:] + left[:-1]) / 2, (up[1:] + up[:-1]) / 2
    return TwoWayGrid(
        left=left,
        up=up,
        power_sr=_power(facing, *centres, np.diff(left), np.diff(up)),
        R_face_antenna=R_face_antenna,
    )


def _edges(share: Float[np.ndarray, " n"], count: int) -> Float[np.ndarray, " edge"]:
    below = np.concatenate([[0.0], np.cumsum(share)])
    shares = np.interp(np.linspace(0, 1, EDGES + 1), below / below[-1], np.linspace(-1, 1, count + 1))
    # As many for every antenna, so that all beams of an array share one compiled kernel; some cells have no width.
    return np.sort(np.concatenate([shares[1:-1], np.linspace(-1.0, 1.0, EDGES + 1)]))


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
    for first in range(0, len(up), step):
        rows = slice(first, first + step)
        direction = _directions(left, up[rows])
        inside = direction[:, 0] > MIN_COSINE
        found = np.zeros(len(direction))
        found[inside] = gain(direction[inside]) ** 2 / direction[inside, 0]
        power[rows] = found.reshape(-1, len(left)) * np.outer(height[rows], width)
    return power


def _directions(left: Float[np.ndarray, " column"], up: Float[np.ndarray, " row"]) -> Float[np.ndarray, "cell 3"]:
    u, v = (grid.ravel() for grid in np.meshgrid(left, up))
    return np.column_stack([np.sqrt(np.maximum(1 - u**2 - v**2, 0.0)), u, v])
