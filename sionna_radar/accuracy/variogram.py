"""The empirical variogram of an error raster: how alike the errors of neighbours are."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.foundation.randomness import Stream, pulse_generator
from sionna_radar.foundation.raster import Raster

CLASSES = 14
# Drawn in each class of lags; those with an empty end are dropped.
PAIRS = 4000
FEWEST_PAIRS = 30
# Of the larger side of the mapped area: beyond, few pairs are independent.
FARTHEST = 0.5


@dataclass(frozen=True, kw_only=True)
class VariogramLag:
    """Half the mean squared difference of two errors at about one distance.

    lag_m: mean distance of the pairs.
    semivariance_m2: Matheron's estimator.
    robust_m2: Dowd's, from the median of the differences, which outliers do not move.
    """

    lag_m: float
    pairs: int
    semivariance_m2: float
    robust_m2: float


@dataclass(frozen=True, kw_only=True)
class Variogram:
    """An empirical variogram.

    variance_m2: of all the errors, which the semivariance approaches at distances without correlation.
    correlation_length_m: distance at which it passes 1 - 1/e of that; None if it does so nowhere, or from the start.
    lags: by ascending distance.
    """

    variance_m2: float
    correlation_length_m: float | None
    lags: tuple[VariogramLag, ...]


def variogram(error: Raster, cells: Bool[np.ndarray, "row column"], seed: int) -> Variogram | None:
    """Return the variogram of the error over some cells; None without enough of them.

    Pairs are drawn, as many in each class of lags: one end among the cells, the other in a random direction.

    Parameters
    ----------
    error:
        DEM minus truth.
    cells:
        Those that count, as far as they are filled.
    seed:
        Of the scenario.

    """
    inside = error.filled & cells
    row, column = np.nonzero(inside)
    if len(row) < FEWEST_PAIRS:
        return None
    values = np.where(inside, error.height_m, np.nan)
    farthest = FARTHEST * max(float(np.ptp(row)), float(np.ptp(column)), 4.0)
    generator = pulse_generator(seed, Stream.VARIOGRAM, 0)
    lags = []
    for low, high in pairwise(np.geomspace(1.0, farthest, CLASSES + 1)):
        start = generator.integers(len(row), size=PAIRS)
        distance, angle = generator.uniform(low, high, PAIRS), generator.uniform(0.0, 2 * np.pi, PAIRS)
        down, right = np.rint(distance * np.sin(angle)).astype(int), np.rint(distance * np.cos(angle)).astype(int)
        other_row, other_column = row[start] + down, column[start] + right
        there = (other_row >= 0) & (other_row < values.shape[0]) & (other_column >= 0)
        there &= other_column < values.shape[1]
        start, other = start[there], (other_row[there], other_column[there])
        step = values[other] - values[row[start], column[start]]
        lag = _lag(step, np.hypot(down[there], right[there]) * error.grid.spacing_m)
        if lag is not None:
            lags.append(lag)
    variance_m2 = float(np.var(error.height_m[inside]))
    return Variogram(variance_m2=variance_m2, correlation_length_m=_length_m(lags, variance_m2), lags=tuple(lags))


def _lag(step_m: Float[np.ndarray, " pair"], distance_m: Float[np.ndarray, " pair"]) -> VariogramLag | None:
    both = np.isfinite(step_m)
    if both.sum() < FEWEST_PAIRS:
        return None
    step = step_m[both]
    return VariogramLag(
        lag_m=float(distance_m[both].mean()),
        pairs=len(step),
        semivariance_m2=float(np.mean(step**2) / 2),
        # 2.198 is the ratio of variance and squared median of |x| of a normal distribution (Dowd 1984).
        robust_m2=float(2.198 * np.median(np.abs(step)) ** 2 / 2),
    )


def _length_m(lags: list[VariogramLag], variance_m2: float) -> float | None:
    goal = (1 - np.exp(-1.0)) * variance_m2
    for before, after in pairwise(lags):
        if before.semivariance_m2 < goal <= after.semivariance_m2:
            share = (goal - before.semivariance_m2) / (after.semivariance_m2 - before.semivariance_m2)
            return before.lag_m + share * (after.lag_m - before.lag_m)
    return None
