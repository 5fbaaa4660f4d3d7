"""Errors that the DEMs of different sensors have in common, because one terrain prior made both.

A DEM that knows the waves of the ground, of prior power S(k), with the information I per area is H = I S / (1 + I S)
times the wave plus noise (Wiener). Its error has the power P = S / (1 + I S): the noise H^2 / I, and what the prior
leaves out, (1 - H) of the wave itself. The noise of two sensors is independent; what both leave out is the same ground:

    variance of one DEM            sum P_i                                  (the stated one; it gives I_i)
    covariance of two              sum (1 - H_i) (1 - H_j) S = sum P_i P_j / S
    variance of their difference   sum P_i + P_j - 2 P_i P_j / S

the sums being over wave vectors, over (2 pi)^2; a mean over a square of the side w weights a wave by
exp(-(k w)^2 / 12). For S falling as k^-2(nu + 1) the errors of two equally good DEMs are correlated by 1 / (nu + 1).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.interpolate import RectBivariateSpline

from sionna_radar.inference.terrain.covariance import MIN_NOISE_M, Covariance

# Longest wave, in lengths of the covariance, shortest wave, in cells, and number of waves.
LONGEST, SHORTEST, WAVES = 30.0, 1e-3, 600
# Entries of the tables of standard deviations, and of information.
TABLE, INFORMATION = 40, 400

Sigma = Float[np.ndarray, " cell"]


@dataclass(frozen=True)
class SharedErrors:
    """Second moments of the errors of two DEMs of the same ground, as functions of their standard deviations.

    covariance: the terrain prior. spacing_m: size of the cells.
    sigma_m: the smallest and the largest standard deviation.
    """

    covariance: Covariance
    spacing_m: float
    sigma_m: tuple[float, float]

    def covariance_m2(self, one_m: Sigma, other_m: Sigma) -> Sigma:
        """Return the covariance of the errors of two DEMs in cells of given standard deviations."""
        return self._looked_up(self._shared, one_m, other_m)

    def mean_variance_m2(self, one_m: Sigma, other_m: Sigma) -> Sigma:
        """Return the variance of the mean of their difference over a square of the side `window_m`."""
        return self._looked_up(self._of_means, one_m, other_m)

    def effective_cells(self, sigma_m: tuple[float, float], cells: int) -> float:
        """Return how many independent differences the cells hold, for a sum of their squares.

        It is the area over the integral of the squared correlation (Bartlett), which by Parseval is that of the squared
        power.
        """
        left = self._left_m2
        number = [int(np.argmin(np.abs(np.log(self._entry_m / each)))) for each in sigma_m]
        one, other = left[number[0]], left[number[1]]
        power = one + other - 2 * one * other / self._prior
        area_m2 = float(self._weight @ power**2) / float(self._weight @ power) ** 2
        return max(1.0, cells * self.spacing_m**2 / max(area_m2, self.spacing_m**2))

    @property
    def window_m(self) -> float:
        """Side of the neighbourhoods in which two DEMs are compared."""
        return NEIGHBOURHOOD_CELLS * self.spacing_m

    def _looked_up(self, table: RectBivariateSpline, one_m: Sigma, other_m: Sigma) -> Sigma:
        low, high = self._entry_m[[0, -1]]
        one, other = (np.log(np.clip(each, low, high)) for each in (one_m, other_m))
        return np.exp(table.ev(one, other))

    @cached_property
    def _waves(self) -> Float[np.ndarray, " wave"]:
        longest = 2 * np.pi / (LONGEST * self.covariance.length_m)
        return np.geomspace(longest, 2 * np.pi / (SHORTEST * self.spacing_m), WAVES)

    @cached_property
    def _weight(self) -> Float[np.ndarray, " wave"]:
        return self._waves**2 * np.gradient(np.log(self._waves)) / (2 * np.pi)

    @cached_property
    def _prior(self) -> Float[np.ndarray, " wave"]:
        return np.maximum(self.covariance.power(self._waves), np.finfo(float).tiny)

    @cached_property
    def _entry_m(self) -> Float[np.ndarray, " entry"]:
        low, high = max(self.sigma_m[0], MIN_NOISE_M), max(self.sigma_m[1], MIN_NOISE_M)
        return np.geomspace(low / 1.01, high * 1.01, TABLE)

    @cached_property
    def _left_m2(self) -> Float[np.ndarray, "entry wave"]:
        """Power of the error, of the standard deviation of each entry; at most the prior's."""
        most = 1e3 / float((self._weight * self._prior)[self._weight * self._prior > 0].min())
        tried = np.geomspace(1e-6 / float(self._prior.max()), min(most, 1e12 / float(self._prior.max())), INFORMATION)
        variance = np.array([self._weight @ (self._prior / (1 + each * self._prior)) for each in tried])
        information = np.exp(np.interp(np.log(self._entry_m), np.log(variance[::-1]) / 2, np.log(tried[::-1])))
        return self._prior / (1 + information[:, None] * self._prior)

    @cached_property
    def _shared(self) -> RectBivariateSpline:
        left = self._left_m2
        return self._table((left * self._weight / self._prior) @ left.T)

    @cached_property
    def _of_means(self) -> RectBivariateSpline:
        left, weight = self._left_m2, self._weight * np.exp(-((self._waves * self.window_m) ** 2) / 12)
        alone = left @ weight
        return self._table(alone[:, None] + alone - 2 * (left * weight / self._prior) @ left.T)

    def _table(self, value_m2: Float[np.ndarray, "entry entry"]) -> RectBivariateSpline:
        entry = np.log(self._entry_m)
        return RectBivariateSpline(entry, entry, np.log(np.maximum(value_m2, np.finfo(float).tiny)), kx=1, ky=1)


# Cells along the side of a neighbourhood; a narrower contradiction is averaged with what surrounds it.
NEIGHBOURHOOD_CELLS = 5
