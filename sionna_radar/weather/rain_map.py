"""Rain that varies with position: a shower, and a random field.

The rate is constant from the ground to above the aircraft; the slant of falling drops in the wind is neglected.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

# Rain below this has no echo; P.838 and Marshall-Palmer are valid far above it.
MIN_MM_PER_H = 0.01
MAX_MM_PER_H = 300.0
NEPERS_PER_DB = math.log(10.0) / 10.0


@runtime_checkable
class RainMap(Protocol):
    """Rain rates by position."""

    def rate_mm_per_h(self, position_m: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape"]:
        """Return the rain rate at positions east and north."""
        ...


@dataclass(frozen=True, kw_only=True)
class RainCell:
    """A shower whose rate falls off exponentially from its centre: R = peak exp(-d / radius).

    The profile of EXCELL (Capsoni et al. 1987, Radio Sci. 22, 387-404: from memory), and the average of cells
    measured by two radars (von Hardenberg et al. 2003, GRL 30, 2280: abstract read). A Gaussian core (HYCELL) of the
    same peak and area has less rain in the middle than these measurements.
    """

    centre_m: tuple[float, float]
    radius_m: float
    peak_mm_per_h: float

    def rate_mm_per_h(self, position_m: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape"]:
        """Return the rain rate at positions east and north."""
        offset_m = position_m - np.array(self.centre_m)
        return self.peak_mm_per_h * np.exp(-np.hypot(offset_m[..., 0], offset_m[..., 1]) / self.radius_m)


@dataclass(frozen=True, kw_only=True)
class RainField:
    """A log-normal rain rate with a mean, and a correlation of its logarithm exp(-d / correlation_m).

    A model choice: rain rates are near log-normal, and their correlation near exponential over some kilometres;
    variations within a few hundred metres are seldom measured. The field repeats after `PERIOD`
    correlation lengths, and is interpolated linearly between nodes, which loses 4 % of its variance.
    """

    mean_mm_per_h: float
    correlation_m: float
    spread_db: float
    seed: int

    NODES_PER_LENGTH = 16
    PERIOD = 32

    @cached_property
    def _normal(self) -> Float[np.ndarray, "node node"]:
        """A periodic Gaussian field of unit variance: white noise filtered by the root of its spectrum."""
        count = self.NODES_PER_LENGTH * self.PERIOD
        steps = np.minimum(np.arange(count), count - np.arange(count)) / self.NODES_PER_LENGTH
        covariance = np.exp(-np.hypot(steps[:, None], steps[None, :]))
        spectrum = np.maximum(np.fft.rfft2(covariance).real, 0.0)
        white = np.random.Generator(np.random.PCG64(self.seed)).standard_normal((count, count))
        return np.fft.irfft2(np.fft.rfft2(white) * np.sqrt(spectrum), s=(count, count))

    def rate_mm_per_h(self, position_m: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape"]:
        """Return the rain rate at positions east and north."""
        grid_position = position_m * (self.NODES_PER_LENGTH / self.correlation_m)
        node = np.floor(grid_position).astype(np.int64)
        share = grid_position - node
        count = self.NODES_PER_LENGTH * self.PERIOD
        (i, j), (u, v) = np.moveaxis(node % count, -1, 0), np.moveaxis(share, -1, 0)
        next_i, next_j = (i + 1) % count, (j + 1) % count
        field = self._normal
        normal = (1 - u) * ((1 - v) * field[i, j] + v * field[i, next_j]) + u * (
            (1 - v) * field[next_i, j] + v * field[next_i, next_j]
        )
        spread = NEPERS_PER_DB * self.spread_db
        return self.mean_mm_per_h * np.exp(spread * normal - spread**2 / 2)


@dataclass(frozen=True, kw_only=True)
class RainTogether:
    """A shower within widespread rain: the rates add."""

    parts: tuple[RainMap, ...]
    everywhere_mm_per_h: float = 0.0

    def rate_mm_per_h(self, position_m: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape"]:
        """Return the rain rate at positions east and north, limited to the range of the models."""
        rate = np.full(position_m.shape[:-1], self.everywhere_mm_per_h)
        for rain in self.parts:
            rate = rate + rain.rate_mm_per_h(position_m)
        return np.minimum(rate, MAX_MM_PER_H)
