"""The ground behind a volume as learned from the survey: how strong it is, and how steep.

Both shape the echo. On ground whose sigma0 falls with the cosine of incidence (constant gamma) the power
of a whole echo over the volume's in one cell is the same at any range and incidence: both fall as r^-2, and the
longer the footprint the weaker each cell. A survey over a few kinds of ground has few such levels. Slopes make an
echo wider or narrower than that of level ground, and bound how far neighbours' heights may differ.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from scipy.special import logsumexp

# Coarser steps far above the volume, where precision matters little: thin fog is below the noise at the ground's range.
LEVELS = 10.0 ** (np.concatenate([np.arange(-6.0, 55.0, 2.0), np.arange(58.0, 91.0, 4.0)]) / 10)
# Rarer levels are dropped.
RAREST_LEVEL = 2e-3
LEVEL_ROUNDS = 200
# Root-mean-square slopes that are compared.
SLOPES = np.geomspace(0.04, 0.8, 9)
FIRST_SLOPE = 0.15


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundBehind:
    """Prior of the ground's echo behind a volume.

    level, level_share: power of a whole echo over the volume's mean in one cell, and its share of the pulses.
    slope: root-mean-square slope of the ground in any direction.
    """

    level: Float[np.ndarray, " level"]
    level_share: Float[np.ndarray, " level"]
    slope: float

    @property
    def mean_slope(self) -> float:
        """Mean absolute slope of the ground along a line."""
        return float(np.sqrt(2 / np.pi)) * self.slope


def unknown_ground() -> GroundBehind:
    """Return ground of any level."""
    return GroundBehind(level=LEVELS, level_share=np.full(len(LEVELS), 1 / len(LEVELS)), slope=FIRST_SLOPE)


def learned_ground(
    level: Float[np.ndarray, " level"], likelihood: Float32[np.ndarray, "slope pulse level"]
) -> GroundBehind:
    """Return the ground under which all pulses together are most likely.

    Parameters
    ----------
    level:
        Levels that were compared.
    likelihood:
        Log-likelihood of each pulse for each of `SLOPES` and level, over all ranges and widths.

    """
    shares, totals = zip(*(_level_share(one) for one in likelihood), strict=True)
    best = int(np.argmax(totals))
    share = shares[best]
    # A level next to a frequent one may be real: the true level lies between two steps.
    kept = share > RAREST_LEVEL
    kept[1:-1] |= kept[2:] | kept[:-2]
    share = np.where(kept, np.maximum(share, RAREST_LEVEL), 0.0)[kept]
    return GroundBehind(level=level[kept], level_share=share / share.sum(), slope=float(SLOPES[best]))


def _level_share(likelihood: Float32[np.ndarray, "pulse level"]) -> tuple[Float[np.ndarray, " level"], float]:
    """Return the most likely shares of the levels, by expectation maximisation, and their log-likelihood."""
    log = likelihood.astype(np.float64)
    share = np.full(log.shape[1], 1 / log.shape[1])
    for _ in range(LEVEL_ROUNDS):
        joint = log + np.log(share)
        share = np.exp(joint - logsumexp(joint, axis=1, keepdims=True)).mean(axis=0)
        share = (share + 1e-6) / np.sum(share + 1e-6)
    return share, float(logsumexp(log + np.log(share), axis=1).sum())
