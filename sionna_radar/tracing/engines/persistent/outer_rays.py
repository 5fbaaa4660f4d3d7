"""Rays for what the scatterers leave out: the beam's skirts, its side lobes, and places without scatterers.

Half of them follow the antenna's two-way power outside the part of the beam that scatterers fill, the others are
spread evenly. They are drawn anew in each pulse: they carry the right power, but no history of phase.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.foundation.numerics import halton
from sionna_radar.foundation.randomness import Stream, pulse_uniforms
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.two_way_grid import TwoWayGrid
from sionna_radar.tracing.engines.persistent.density import FilledBeam, power_grid

FOLLOWING = 0.5


class OuterRays:
    """Draws directions outside a part of a beam, and few inside.

    Parameters
    ----------
    antenna:
        Whose power they follow.
    filled:
        The part of the beam to be left out.
    rays:
        How many a pulse.
    seed:
        Of the directions.

    """

    def __init__(self, antenna: Antenna, filled: FilledBeam, rays: int, seed: int) -> None:
        self._grid = power_grid(antenna)
        self._power, self._below = _outside(antenna, filled)
        self._ahead = antenna.separable
        following = round(rays * FOLLOWING) if self._below[-1] > 0 else 0
        self.rays, self._share, self._seed = rays, following / rays, seed
        self._unit = np.concatenate([halton(following), halton(rays - following)])
        self._following = following

    def shoot(self, pulse: Int[np.ndarray, " pulse"]) -> tuple[Float[np.ndarray, "ray 3"], Float[np.ndarray, " ray"]]:
        """Return unit vectors in the antenna's frame, pulse by pulse, and how many rays there are per steradian.

        The density is zero where a ray must not be used.
        """
        shift = pulse_uniforms(self._seed, Stream.DIRECTIONS, pulse, 2)
        unit = np.mod(self._unit[None] + shift[:, None], 1.0)
        along, anywhere = (part.reshape(-1, 2) for part in np.split(unit, [self._following], axis=1))
        drawn = self._along_power(along), self._anywhere(anywhere)
        direction = np.concatenate([part.reshape(len(pulse), -1, 3) for part in drawn], axis=1).reshape(-1, 3)
        return direction, self.rays * self._density(direction)

    def _along_power(self, unit: Float[np.ndarray, "ray 2"]) -> Float[np.ndarray, "ray 3"]:
        grid = self._grid
        columns = len(grid.left) - 1
        cell = np.minimum(np.searchsorted(self._below, unit[:, 0] * self._below[-1]), len(self._below) - 1)
        power = self._power.ravel()[cell]
        part = np.clip((unit[:, 0] - (self._below[cell] - power)) / np.maximum(power, 1e-300), 0.0, 1.0)
        row, column = np.divmod(cell, columns)
        u = grid.left[column] + part * (grid.left[column + 1] - grid.left[column])
        v = grid.up[row] + unit[:, 1] * (grid.up[row + 1] - grid.up[row])
        cos2 = 1 - u**2 - v**2
        face = np.column_stack([np.sqrt(np.maximum(cos2, 0.0)), u, v])
        # Beyond the half sphere there is nothing: such a ray has no density, below, as its length is not one.
        return face @ grid.R_face_antenna

    def _anywhere(self, unit: Float[np.ndarray, "ray 2"]) -> Float[np.ndarray, "ray 3"]:
        ahead = unit[:, 0] if self._ahead else 2 * unit[:, 0] - 1
        aside, turn = np.sqrt(np.maximum(1 - ahead**2, 0.0)), 2 * np.pi * unit[:, 1]
        return np.column_stack([ahead, aside * np.cos(turn), aside * np.sin(turn)])

    def _density(self, direction: Float[np.ndarray, "ray 3"]) -> Float[np.ndarray, " ray"]:
        grid = self._grid
        normal, u, v = (direction @ grid.R_face_antenna.T).T
        column = np.clip(np.searchsorted(grid.left, u, side="right") - 1, 0, len(grid.left) - 2)
        row = np.clip(np.searchsorted(grid.up, v, side="right") - 1, 0, len(grid.up) - 2)
        area = (grid.left[column + 1] - grid.left[column]) * (grid.up[row + 1] - grid.up[row])
        following = np.where(normal > 0, normal * self._power[row, column] / np.maximum(area, 1e-20), 0.0)
        anywhere = np.where(direction[:, 0] > 0, 1 / (2 * np.pi), 0.0) if self._ahead else 1 / (4 * np.pi)
        whole = np.abs(np.einsum("ni,ni->n", direction, direction) - 1) < 1e-6
        return np.where(whole, self._share * following + (1 - self._share) * anywhere, 0.0)


@lru_cache(maxsize=2)
def _outside(
    antenna: Antenna, filled: FilledBeam
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, " cell"]]:
    """Return each cell's share of the power outside a part of a beam, and the sums of those up to each."""
    grid = power_grid(antenna)
    power = np.where(_within(grid, filled), 0.0, grid.power_sr)
    power /= max(power.sum(), 1e-300)
    return power, np.cumsum(power.ravel())


def _within(grid: TwoWayGrid, filled: FilledBeam) -> Bool[np.ndarray, "row column"]:
    """Return whether cells lie wholly in the part of the beam that is left out."""
    u, v = np.meshgrid(grid.left, grid.up)
    face = np.stack([np.sqrt(np.maximum(1 - u**2 - v**2, 0.0)), u, v], axis=-1)
    inside = filled.holds(face.reshape(-1, 3) @ grid.R_face_antenna).reshape(u.shape)
    return inside[1:, 1:] & inside[1:, :-1] & inside[:-1, 1:] & inside[:-1, :-1]
