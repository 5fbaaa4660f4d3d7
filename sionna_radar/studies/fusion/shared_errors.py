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
from scipy.special import j0

from sionna_radar.inference.terrain.covariance import Covariance
from sionna_radar.inference.terrain.covariance_fit import MIN_NOISE_M

# Longest wave, in lengths of the covariance, shortest wave, in cells, and number of waves.
LONGEST, SHORTEST, WAVES = 30.0, 1e-3, 600
# Entries of the tables of standard deviations, and of information; span of that, in the inverse of the prior's power.
TABLE, INFORMATION, SPAN = 40, 400, (1e-6, 1e15)
# Entries of a table of correlations.
DISTANCES = 200

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
        left = self._left_m2
        return self._looked_up((left * self._weight / self._prior) @ left.T, one_m, other_m)

    def mean_variance_m2(self, one_m: Sigma, other_m: Sigma, window_m: float) -> Sigma:
        """Return the variance of the mean of their difference over a square."""
        left, weight = self._left_m2, self._weight * np.exp(-((self._waves * window_m) ** 2) / 12)
        alone = left @ weight
        both = alone[:, None] + alone - 2 * (left * weight / self._prior) @ left.T
        return self._looked_up(both, one_m, other_m)

    def resolution_m(self, sigma_m: float) -> float:
        """Return the distance of independent heights, of a standard deviation, that know as much as a DEM of it does.

        Their information per area is that of the DEM: one over variance and squared distance.
        """
        left = self._left_m2[int(np.searchsorted(self._entry_m, sigma_m))]
        best = int(np.argmax(left * self._weight))
        return float(1 / np.sqrt((1 / left[best] - 1 / self._prior[best]) * sigma_m**2))

    def correlation(
        self, one_m: float, other_m: float, distance_m: Float[np.ndarray, "..."]
    ) -> Float[np.ndarray, "..."]:
        """Return the correlation of their difference between places at a distance."""
        power = self._weight * self._difference(one_m, other_m)
        entry_m = np.linspace(0.0, np.sqrt(float(distance_m.max())), DISTANCES) ** 2
        return np.interp(distance_m, entry_m, j0(entry_m[:, None] * self._waves) @ power / power.sum())

    def independent(self, one_m: float, other_m: float, cells: int) -> float:
        """Return the effective number of independent differences in the cells, for a sum of their squares.

        It is their area over the integral of the squared correlation (Bartlett 1946), by Parseval's theorem that of the
        squared power; at least one, at most the cells.
        """
        power = self._difference(one_m, other_m)
        correlated_m2 = float(self._weight @ power**2) / float(self._weight @ power) ** 2
        return max(1.0, cells * min(1.0, self.spacing_m**2 / correlated_m2))

    def _difference(self, one_m: float, other_m: float) -> Float[np.ndarray, " wave"]:
        """Return the power of the difference of two DEMs of about these standard deviations."""
        one, other = (self._left_m2[int(np.searchsorted(self._entry_m, each))] for each in (one_m, other_m))
        return np.asarray(one + other - 2 * one * other / self._prior)

    def _looked_up(self, value_m2: Float[np.ndarray, "entry entry"], one_m: Sigma, other_m: Sigma) -> Sigma:
        """Interpolate a table linearly in logarithms."""
        entry = np.log(self._entry_m)
        table = RectBivariateSpline(entry, entry, np.log(np.maximum(value_m2, np.finfo(float).tiny)), kx=1, ky=1)
        return np.exp(table.ev(np.log(one_m), np.log(other_m)))

    @cached_property
    def _waves(self) -> Float[np.ndarray, " wave"]:
        longest = 2 * np.pi / (LONGEST * self.covariance.length_m)
        return np.geomspace(longest, 2 * np.pi / (SHORTEST * self.spacing_m), WAVES)

    @cached_property
    def _weight(self) -> Float[np.ndarray, " wave"]:
        return self._waves**2 * np.gradient(np.log(self._waves)) / (2 * np.pi)

    @cached_property
    def _prior(self) -> Float[np.ndarray, " wave"]:
        power = self.covariance.power(self._waves)
        return np.maximum(power, 1e-30 * power.max())

    @cached_property
    def _entry_m(self) -> Float[np.ndarray, " entry"]:
        low, high = (max(each, MIN_NOISE_M) for each in self.sigma_m)
        return np.geomspace(low / 1.01, high * 1.01, TABLE)

    @cached_property
    def _left_m2(self) -> Float[np.ndarray, "entry wave"]:
        """Power of the error of a DEM of each standard deviation, or of the prior where that is smaller."""
        tried = np.geomspace(*SPAN, INFORMATION) / self._prior.max()
        variance = (self._prior / (1 + tried[:, None] * self._prior)) @ self._weight
        information = np.exp(np.interp(np.log(self._entry_m), np.log(variance[::-1]) / 2, np.log(tried[::-1])))
        return self._prior / (1 + information[:, None] * self._prior)
