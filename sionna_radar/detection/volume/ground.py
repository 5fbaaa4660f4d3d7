"""Prior of the ground's echo behind a volume: its level and slope, learned from a survey.

Both shape the echo. On ground whose sigma0 falls with the cosine of incidence (constant gamma) the power of a whole
echo over the volume's in one cell is the same at any range and incidence: both fall as r^-2, and the longer the
footprint the weaker each cell. A survey over a few kinds of ground has few such levels. Slopes make an echo wider or
narrower than that of level ground, and bound how far neighbours' heights may differ.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from scipy.special import ndtri

from sionna_radar.detection.volume.height_track import MIN_DOWN
from sionna_radar.foundation.numerics import log_sum_exp

# Coarser steps far above the volume, where precision matters little: thin fog is below the noise at the ground's range.
LEVELS = 10.0 ** (np.concatenate([np.arange(-6.0, 55.0, 2.0), np.arange(58.0, 91.0, 4.0)]) / 10)
# Levels of a smaller weight are dropped.
MIN_LEVEL_WEIGHT = 2e-3
LEVEL_ROUNDS = 200
# Candidate root-mean-square slopes.
SLOPES = np.geomspace(0.01, 0.8, 13)
FIRST_SLOPE = 0.15
# Standard normal deviates of equal probability that sample the ground's slopes.
DEVIATES = ndtri((np.arange(9) + 0.5) / 9)


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundBehind:
    """Prior of the ground's echo behind a volume.

    level, level_weight: power of a whole echo over the volume's mean in one cell, and its fraction of the pulses.
    slope: root-mean-square slope of the ground in any direction.
    cell: median range of the ground in cells; 0 if unknown.
    """

    level: Float[np.ndarray, " level"]
    level_weight: Float[np.ndarray, " level"]
    slope: float
    cell: int = 0

    @property
    def mean_slope(self) -> float:
        """Mean absolute slope of the ground along a line."""
        return float(np.sqrt(2 / np.pi)) * self.slope


def unknown_ground() -> GroundBehind:
    """Return ground of any level."""
    return GroundBehind(level=LEVELS, level_weight=np.full(len(LEVELS), 1 / len(LEVELS)), slope=FIRST_SLOPE)


def learned_ground(
    level: Float[np.ndarray, " level"], likelihood: Float32[np.ndarray, "slope pulse level"]
) -> GroundBehind:
    """Return the maximum-likelihood ground over all pulses.

    Parameters
    ----------
    level:
        Candidate levels.
    likelihood:
        Log-likelihood of each pulse for each of `SLOPES` and level, over all ranges and widths.

    """
    weights, totals = zip(*(_level_weights(per_slope) for per_slope in likelihood), strict=True)
    best = int(np.argmax(totals))
    weight = weights[best]
    # Keep neighbours of frequent levels: the true level lies between two steps.
    significant = weight > MIN_LEVEL_WEIGHT
    significant[1:-1] |= significant[2:] | significant[:-2]
    weight = np.where(significant, np.maximum(weight, MIN_LEVEL_WEIGHT), 0.0)[significant]
    return GroundBehind(level=level[significant], level_weight=weight / weight.sum(), slope=float(SLOPES[best]))


def _level_weights(likelihood: Float32[np.ndarray, "pulse level"]) -> tuple[Float[np.ndarray, " level"], float]:
    """Return the most likely weights of the levels, by expectation maximisation, and their log-likelihood."""
    log = likelihood.astype(np.float64)
    relative = np.exp(log - log.max(axis=1, keepdims=True))
    weight = np.full(log.shape[1], 1 / log.shape[1])
    for _ in range(LEVEL_ROUNDS):
        weight = weight * ((1 / (relative @ weight)) @ relative) / len(log)
        weight += 1e-6
        weight /= weight.sum()
    return weight, float(log_sum_exp(log + np.log(weight), axis=1).sum())


def slopes_of(slope: float) -> Float[np.ndarray, " sample"]:
    """Return equally probable angles, rad, by which ground of a root-mean-square slope rises away from the radar."""
    return np.asarray(np.arctan(slope * DEVIATES))


def mean_tangent(incidence: Float[np.ndarray, " pulse"], slope: float) -> Float[np.ndarray, " pulse"]:
    """Return the mean tangent of the incidence on ground of a root-mean-square slope, as the beam's axis meets it.

    The axis meets slopes in proportion to the area that they turn towards the radar, the cosine of the incidence there.
    incidence: on level ground, rad.
    """
    on_slopes = np.minimum(incidence[:, None] - slopes_of(slope), np.arccos(MIN_DOWN))
    mean: Float[np.ndarray, " pulse"] = np.sin(on_slopes).sum(axis=1) / np.cos(on_slopes).sum(axis=1)
    return mean
