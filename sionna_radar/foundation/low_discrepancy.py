"""Points that fill a square evenly, as `scipy.stats.qmc.Halton` gives them without scrambling, bit for bit.

`scipy.stats` takes as long to import as many a survey to simulate.
"""

import numpy as np
from jaxtyping import Float


def halton(count: int) -> Float[np.ndarray, "{count} 2"]:
    """Return the first points of the Halton sequence in two dimensions (Halton 1960), the origin first."""
    points = np.zeros((count, 2))
    for axis, base in enumerate((2, 3)):
        rest, share = np.arange(count), 1.0
        while rest.any():
            share /= base
            points[:, axis] += (rest % base) * share
            rest //= base
    return points
