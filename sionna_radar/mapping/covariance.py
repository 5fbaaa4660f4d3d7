"""Covariance of terrain heights, estimated from scattered heights by maximum likelihood.

The Matern family spans rough to infinitely smooth terrain: exponential (smoothness 1/2), 3/2, 5/2 and Gaussian
(infinite), each with a length and a variance (Stein 1999, "Interpolation of Spatial Data"). The noise of the heights
is known from speckle up to a factor, which is fitted too and absorbs errors of the noise model.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import LinAlgError, cholesky, solve_triangular
from scipy.optimize import minimize
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from sionna_radar.foundation.raster import Grid

SMOOTHNESSES = (0.5, 1.5, 2.5, np.inf)
# Likelihoods are summed over groups of near neighbours: a large survey is too much to treat at once.
GROUP, GROUPS = 350, 2
LEAST_NOISE_M = 1e-3


@dataclass(frozen=True)
class Covariance:
    """A stationary, isotropic covariance of heights."""

    smoothness: float
    length_m: float
    variance_m2: float

    def at(self, distance_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the covariance of heights at a distance."""
        return self.variance_m2 * _correlation(self.smoothness, distance_m / self.length_m)

    def spectrum_root(self, grid: Grid) -> Float[np.ndarray, "row frequency"]:
        """Return the square root of the power spectrum on the grid's real Fourier frequencies.

        White noise of unit variance, filtered with it, has this covariance (periodic over the grid).
        """
        north = 2 * np.pi * np.fft.fftfreq(grid.rows, grid.spacing_m)[:, None]
        east = 2 * np.pi * np.fft.fftfreq(grid.columns, grid.spacing_m)[None]
        density = self._density(np.hypot(east, north))
        half = density[:, : grid.columns // 2 + 1]
        return np.sqrt(half * self.variance_m2 / density.mean())

    def _density(self, wavenumber: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        if np.isinf(self.smoothness):
            return np.exp(-((wavenumber * self.length_m) ** 2) / 2)
        return (2 * self.smoothness / self.length_m**2 + wavenumber**2) ** -(self.smoothness + 1)


@dataclass(frozen=True)
class FittedCovariance:
    """A covariance and the factor on the variance of the noise that goes with it."""

    covariance: Covariance
    noise_factor: float


def fit_covariance(
    place_m: Float[np.ndarray, "n 2"], height_m: Float[np.ndarray, " n"], sigma_m: Float[np.ndarray, " n"]
) -> FittedCovariance:
    """Fit covariance and noise to scattered heights.

    Parameters
    ----------
    place_m, height_m:
        Horizontal positions and their heights above a trend.
    sigma_m:
        Standard deviations of their noise, up to a common factor.

    """
    groups = _groups(place_m)
    extent = float(np.ptp(place_m, axis=0).max())
    variance = max(float(np.var(height_m)), LEAST_NOISE_M**2)
    problem = [(cdist(place_m[g], place_m[g]), height_m[g], np.maximum(sigma_m[g], LEAST_NOISE_M) ** 2) for g in groups]
    best: tuple[float, FittedCovariance] | None = None
    for smoothness in SMOOTHNESSES:

        def loss(parameters: Float[np.ndarray, "3"], smoothness: float = smoothness) -> float:
            length, scale, factor = np.exp(parameters)
            if not (1e-3 * extent < length < extent and 1e-4 < factor < 1e4):
                return 1e12
            covariance = Covariance(smoothness, float(length), float(scale))
            return sum(_negative_log_likelihood(covariance, factor * n, d, z) for d, z, n in problem)

        start = np.log([0.15 * extent, variance, 1.0])
        simplex = start + np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1.0]])
        options = {"maxiter": 90, "xatol": 0.03, "fatol": 0.1, "initial_simplex": simplex}
        found = minimize(loss, start, method="Nelder-Mead", options=options)
        if best is None or found.fun < best[0]:
            length, scale, factor = (float(value) for value in np.exp(found.x))
            best = float(found.fun), FittedCovariance(Covariance(smoothness, length, scale), factor)
    assert best is not None
    return best[1]


def _correlation(smoothness: float, scaled: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    if np.isinf(smoothness):
        return np.exp(-(scaled**2) / 2)
    root = np.sqrt(2 * smoothness) * scaled
    polynomial = {0.5: 1.0, 1.5: 1 + root, 2.5: 1 + root + root**2 / 3}[smoothness]
    return polynomial * np.exp(-root)


def _negative_log_likelihood(
    covariance: Covariance,
    noise_m2: Float[np.ndarray, " n"],
    distance_m: Float[np.ndarray, "n n"],
    height_m: Float[np.ndarray, " n"],
) -> float:
    try:
        root = cholesky(covariance.at(distance_m) + np.diag(noise_m2 + 1e-9 * covariance.variance_m2), lower=True)
    except LinAlgError:
        return 1e12
    white = solve_triangular(root, height_m, lower=True)
    return float(white @ white / 2 + np.log(np.diag(root)).sum())


def _groups(place_m: Float[np.ndarray, "n 2"]) -> list[np.ndarray]:
    """Return groups of neighbours around points far from each other."""
    if len(place_m) <= GROUP * GROUPS:
        return [np.arange(len(place_m))]
    centre = int(np.argmin(np.sum((place_m - np.median(place_m, axis=0)) ** 2, axis=1)))
    tree, groups = KDTree(place_m), []
    for _ in range(GROUPS):
        near = tree.query(place_m[centre], k=GROUP)[1]
        groups.append(np.sort(near))
        taken = np.concatenate(groups)
        centre = int(np.argmax(cdist(place_m, place_m[taken]).min(axis=1)))
    return groups
