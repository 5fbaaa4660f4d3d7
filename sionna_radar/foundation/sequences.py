"""Low-discrepancy sequences: points that fill a square evenly, and indices spread over a range.

Halton points are those of `scipy.stats.qmc.Halton` without scrambling, bit for bit. `scipy.stats` takes as long to
import as many a survey to simulate.
"""

import numpy as np
from jaxtyping import Float, Int

GOLDEN_RATIO = (1 + 5**0.5) / 2


def halton(count: int) -> Float[np.ndarray, "{count} 2"]:
    """Return the first points of the Halton sequence in two dimensions (Halton 1960), the origin first."""
    points = np.zeros((count, 2))
    for axis, base in enumerate((2, 3)):
        rest, fraction = np.arange(count), 1.0
        while rest.any():
            fraction /= base
            points[:, axis] += (rest % base) * fraction
            rest //= base
    return points


def spread_indices(count: int, total: int) -> Int[np.ndarray, " chosen"]:
    """Return about `count` indices below `total` in rising order, the first and the last among them; or all.

    One is in each of `count` equal parts, at places that follow the golden ratio: equal steps through the pulses of a
    survey may be whole turns of its scan, and meet a few of its angles only.
    """
    if count >= total:
        return np.arange(total)
    part = np.arange(count)
    index = np.floor((part + part * GOLDEN_RATIO % 1.0) * total / count).astype(np.int64)
    index[-1:] = total - 1
    return np.unique(index)
