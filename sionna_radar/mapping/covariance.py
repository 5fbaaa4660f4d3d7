"""Covariance of terrain heights, estimated from scattered heights by maximum likelihood.

The Matern family spans rough to infinitely smooth terrain: exponential (smoothness 1/2), 3/2, 5/2 and Gaussian
(infinite), each with a length and a variance (Stein 1999, "Interpolation of Spatial Data"). The noise of the heights
is known from speckle up to a factor, which is fitted too and absorbs errors of the noise model.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf
from scipy.optimize import minimize
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from sionna_radar.foundation.raster import Grid

SMOOTHNESSES = (0.5, 1.5, 2.5, np.inf)
# Likelihoods are summed over groups of near neighbours: a large survey is too much to treat at once.
GROUP, GROUPS = 350, 2
LEAST_NOISE_M = 1e-3
# A likelihood outside the bounds, or of a matrix that is not positive definite.
FORBIDDEN = 1e12
Group = tuple[Float[np.ndarray, "n n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]


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
    start = np.log([0.15 * extent, 1 / variance])
    for smoothness in SMOOTHNESSES:
        # The likeliest variance for a length and a ratio of noise to variance is known in closed form.
        def loss(parameters: Float[np.ndarray, "2"], smoothness: float = smoothness) -> float:
            length, ratio = np.exp(parameters)
            if not (1e-3 * extent < length < extent and 1e-4 < ratio * variance < 1e4):
                return FORBIDDEN
            return _profile_likelihood(smoothness, float(length), float(ratio), problem)[0]

        simplex = start + np.array([[0, 0], [1, 0], [0, -1.0]])
        options = {"maxiter": 90, "xatol": 0.03, "fatol": 0.1, "initial_simplex": simplex}
        found = minimize(loss, start, method="Nelder-Mead", options=options)
        if best is None or found.fun < best[0]:
            length, ratio = (float(value) for value in np.exp(found.x))
            scale = _profile_likelihood(smoothness, length, ratio, problem)[1]
            best = float(found.fun), FittedCovariance(Covariance(smoothness, length, scale), ratio * scale)
    assert best is not None
    return best[1]


def _profile_likelihood(smoothness: float, length_m: float, ratio: float, problem: list[Group]) -> tuple[float, float]:
    """Return the negative log-likelihood at the likeliest variance, and that variance.

    ratio: factor on the variances of the noise, over the variance of the terrain.
    """
    square, logs, count = 0.0, 0.0, 0
    for distance_m, height_m, noise_m2 in problem:
        matrix = _correlation(smoothness, distance_m / length_m)
        matrix.flat[:: len(matrix) + 1] += ratio * noise_m2 + 1e-9
        # Symmetric, so that its transpose, in LAPACK's order, is the matrix too.
        root, failed = dpotrf(matrix.T, lower=1, clean=0, overwrite_a=1)
        if failed:
            return FORBIDDEN, 0.0
        white = solve_triangular(root, height_m, lower=True, check_finite=False)
        square += float(white @ white)
        logs += float(np.log(np.diag(root)).sum())
        count += len(height_m)
    scale = max(square / count, LEAST_NOISE_M**2)
    return square / scale / 2 + logs + count * np.log(scale) / 2, scale


def _correlation(smoothness: float, scaled: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    if np.isinf(smoothness):
        return np.exp(-(scaled**2) / 2)
    root = np.sqrt(2 * smoothness) * scaled
    falling = np.exp(-root)
    if smoothness == 1.5:
        falling *= 1 + root
    elif smoothness == 2.5:
        falling *= 1 + root + root**2 / 3
    return falling


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
