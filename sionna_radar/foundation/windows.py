"""Window functions over samples, as SciPy computes them, bit for bit.

`scipy.signal` brings `scipy.stats` and more with it: for one window it would take as long as many a survey.
"""

import numpy as np
from jaxtyping import Float

# Factors of the cosines of 0, 1, ... turns over the window.
COSINES = {
    "hann": (0.5, 0.5),
    "hamming": (0.54, 1 - 0.54),
    "blackman": (0.42, 0.50, 0.08),
    "blackmanharris": (0.35875, 0.48829, 0.14128, 0.01168),
}


def window(name: str, samples: int) -> Float[np.ndarray, " sample"]:
    """Return a periodic window by its name in `scipy.signal.get_window`."""
    if name not in COSINES:
        from scipy.signal import get_window

        return get_window(name, samples)
    if samples == 1:
        return np.ones(1)
    turn, total = np.linspace(-np.pi, np.pi, samples + 1), np.zeros(samples + 1)
    for number, factor in enumerate(COSINES[name]):
        total += factor * np.cos(number * turn)
    return total[:-1]


def unit_window(name: str, samples: int) -> Float[np.ndarray, " sample"]:
    """Return a periodic window with a sum of one; see `window`."""
    values = window(name, samples)
    return values / values.sum()


def taylor(count: int, nbar: int, side_lobe_ratio_db: float) -> Float[np.ndarray, " element"]:
    """Return the symmetric Taylor window of `scipy.signal.windows.taylor`, not normalised.

    Doerry 2017, "Catalog of Window Taper Functions for Sidelobe Control", Sandia SAND2017-4042, section on Taylor
    windows.
    """
    if count == 1:
        return np.ones(1)
    A = np.arccosh(np.float64(10 ** (side_lobe_ratio_db / 20))) / np.pi
    s2 = nbar**2 / (A**2 + (nbar - 0.5) ** 2)
    order = np.arange(1, nbar, dtype=float)
    square, sign = order * order, np.where(np.arange(nbar - 1) % 2 == 0, 1.0, -1.0)
    factor = np.empty(nbar - 1)
    for m in range(nbar - 1):
        above = sign[m] * np.prod(1 - square[m] / s2 / (A**2 + (order - 0.5) ** 2))
        below = 2 * np.prod(1 - square[m] / square[:m]) * np.prod(1 - square[m] / square[m + 1 :])
        factor[m] = above / below
    place = np.arange(count, dtype=float)
    return 1 + 2 * np.matmul(factor, np.cos(2 * np.pi * order[:, None] * (place - count / 2.0 + 0.5) / count))
