"""Matern covariance of terrain heights, and tables of it.

The Matern family spans rough to infinitely smooth terrain by its smoothness, from fractal (0.3 to 1, the Hurst
exponent) to Gaussian (infinite), with a length and a variance (Stein 1999, "Interpolation of Spatial Data").

The mean of the terrain over a beam's footprint has the covariance smoothed with it: a Matern covariance is a mixture of
Gaussian ones with gamma-distributed squares of their lengths, and a Gaussian smoothed with Gaussian footprints is again
Gaussian.

Real ground carries microrelief on its landforms: tillage, tussocks, stones, rills. It is nearly fractal, with a Hurst
exponent of about 1/2 (Shepard et al. 2001, "The roughness of natural terrain"), and exceeds the tail of any covariance
of smooth hills. It is a second, exponential covariance, by which the difference of two heights grows as the square root
of their distance.

Covariances of many pairs of heights are interpolated linearly in a table that is dense near zero. Its entries are
equally spaced in the square root of the distance, so that one is found without a search. They are those of a cubic
spline in its fourth root, which is smoother than the table is dense.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.special import gammaln, kve

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import over_rows

# The mixture of Gaussian covariances: how many, and the shortest squared length, in nepers from the mean.
MIXTURE, SHORTEST = 48, -14.0
# Entries of a table of covariances, and knots of the spline that it is made from, which errs by less than 1e-8
# variances, ten times less than the table does.
ENTRIES, KNOTS = 6000, 400
# Length over which differences of microrelief grow; longer waves are those of the landforms.
MICRORELIEF_LENGTH_M = 10.0


@dataclass(frozen=True)
class CovarianceTable:
    """Covariances at the distances 0, step, 4 step, 9 step and so on, which they do not exceed."""

    step_m: float
    value_m2: Float[np.ndarray, " entry"]

    @classmethod
    def of(cls, value_m2: Float[np.ndarray, " knot"], farthest_m: float) -> "CovarianceTable":
        """Return the table of covariances at the `knots`."""
        return cls(float(cls.distances(farthest_m)[1]), tabulated(value_m2, farthest_m))

    @staticmethod
    def distances(farthest_m: float, entries: int = ENTRIES) -> Float[np.ndarray, " {entries}"]:
        """Return the distances of the entries of a table that reaches to the farthest."""
        return np.linspace(0.0, np.sqrt(farthest_m), entries) ** 2

    def at(self, distance_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the covariance at distances."""
        result = np.empty(distance_m.shape)
        look_up(np.ascontiguousarray(distance_m).ravel(), self.step_m, self.value_m2, result.reshape(-1))
        return result

    def between(
        self, one_m: Float[np.ndarray, "*window n 2"], other_m: Float[np.ndarray, "*window m 2"]
    ) -> Float[np.ndarray, "*window n m"]:
        """Return the covariance between places, of windows or not."""
        one, other = (each.reshape(-1, *each.shape[-2:]) for each in (one_m, other_m))
        covariances = covariances_between(one, other, self.step_m, self.value_m2[None])
        return covariances.reshape(*one_m.shape[:-1], -1)


def knots(farthest_m: float) -> Float[np.ndarray, " knot"]:
    """Return the distances of covariances that `tabulated` makes tables from, up to the farthest."""
    return np.linspace(0.0, farthest_m**0.25, KNOTS) ** 4


def tabulated(value_m2: Float[np.ndarray, "... knot"], farthest_m: float) -> Float[np.ndarray, "... entry"]:
    """Return the values of tables from those at the `knots`."""
    spline = CubicSpline(np.linspace(0.0, farthest_m**0.25, KNOTS), value_m2, axis=-1)
    return spline(CovarianceTable.distances(farthest_m) ** 0.25)


def covariances_between(
    one_m: Float[np.ndarray, "window n 2"],
    other_m: Float[np.ndarray, "window m 2"],
    step_m: float,
    value_m2: Float[np.ndarray, "table entry"],
) -> Float[np.ndarray, "window n m"]:
    """Return the covariances between the places of windows, from a table for each of them, or one for all."""
    one, other, value = (np.ascontiguousarray(each) for each in (one_m, other_m, value_m2))
    result = np.empty((len(one), one.shape[1], other.shape[1]))
    if len(one) == 1:
        over_rows(lambda low, high: between(one[:, low:high], other, step_m, value, result[:, low:high]), one.shape[1])
    else:
        between(one, other, step_m, value, result)
    return result


@dataclass(frozen=True)
class Covariance:
    """A stationary, isotropic covariance of heights.

    smoothness, length_m, variance_m2: of the landforms.
    microrelief_m: RMS difference, over 1 m, of the fractal relief upon them; 0 for none.
    """

    smoothness: float
    length_m: float
    variance_m2: float
    microrelief_m: float = 0.0

    @property
    def landforms(self) -> "Covariance":
        """The covariance of the landforms alone."""
        return replace(self, microrelief_m=0.0)

    @property
    def microrelief(self) -> "Covariance":
        """The covariance of the microrelief alone."""
        return Covariance(0.5, MICRORELIEF_LENGTH_M, self.microrelief_m**2 / -2 / math.expm1(-1 / MICRORELIEF_LENGTH_M))

    def at(self, distance_m: Float[np.ndarray, "..."], spread_m: float = 0.0) -> Float[np.ndarray, "..."]:
        """Return the covariance of heights at a distance.

        spread_m: standard deviation, along each axis, of Gaussian footprints over which both are averaged.
        """
        if self.microrelief_m > 0.0:
            return self.landforms.at(distance_m, spread_m) + self.microrelief.at(distance_m, spread_m)
        if spread_m == 0.0:
            return self.variance_m2 * _correlation(self.smoothness, distance_m / self.length_m)
        square, share = self._mixture
        widened = square + 2 * spread_m**2
        weight = share * square / widened
        exponent: Float[np.ndarray, ...] = np.multiply.outer(-(distance_m**2), 0.5 / widened)
        return self.variance_m2 * (np.exp(exponent, out=exponent) @ weight)

    def table(self, farthest_m: float, spread_m: float) -> CovarianceTable:
        """Return a table of the covariance up to a distance; see `at`."""
        return CovarianceTable.of(self.at(knots(farthest_m), spread_m), farthest_m)

    def power(self, wavenumber: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the power spectral density, m^4: its integral over wave vectors is (2 pi)^2 variances."""
        if self.microrelief_m > 0.0:
            return self.landforms.power(wavenumber) + self.microrelief.power(wavenumber)
        if np.isinf(self.smoothness):
            scale = 2 * np.pi * self.length_m**2
        else:
            nu = self.smoothness
            scale = 4 * np.pi * nu * (2 * nu / self.length_m**2) ** nu
        return self.variance_m2 * scale * self._density(wavenumber)

    def spectrum_root(self, grid: Grid) -> Float[np.ndarray, "row frequency"]:
        """Return the square root of the power spectrum on the grid's real Fourier frequencies.

        White noise of unit variance, filtered with it, has this covariance (periodic over the grid).
        """
        if self.microrelief_m > 0.0:
            return np.hypot(self.landforms.spectrum_root(grid), self.microrelief.spectrum_root(grid))
        north = 2 * np.pi * np.fft.fftfreq(grid.rows, grid.spacing_m)[:, None]
        east = 2 * np.pi * np.fft.fftfreq(grid.columns, grid.spacing_m)[None]
        density = self._density(np.hypot(east, north))
        half = density[:, : grid.columns // 2 + 1]
        return np.sqrt(half * self.variance_m2 / density.mean())

    def _density(self, wavenumber: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        if np.isinf(self.smoothness):
            return np.exp(-((wavenumber * self.length_m) ** 2) / 2)
        return (2 * self.smoothness / self.length_m**2 + wavenumber**2) ** -(self.smoothness + 1)

    @cached_property
    def _mixture(self) -> tuple[Float[np.ndarray, " part"], Float[np.ndarray, " part"]]:
        """Return squared lengths of Gaussian covariances and their shares.

        With s gamma-distributed of shape nu and rate 2 nu / L^2, the mean of exp(-d^2 / 4 s) over s is Matern. The
        shares of rough terrain sum to less than one: the rest is of lengths far below any footprint, and averages out.
        """
        if np.isinf(self.smoothness):
            return np.array([self.length_m**2]), np.ones(1)
        nu = self.smoothness
        log = np.linspace(max(SHORTEST, -16 / nu - 2), np.log(1 + 16 / nu + 6 / np.sqrt(nu)), MIXTURE)
        density = np.exp(nu * log - np.exp(log) * nu + nu * np.log(nu) - gammaln(nu))
        return np.exp(log) * self.length_m**2, density * (log[1] - log[0])


@dataclass(frozen=True)
class FittedCovariance:
    """A fitted covariance with its factor on the noise variance."""

    covariance: Covariance
    noise_factor: float


def _correlation(smoothness: float, scaled: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    if np.isinf(smoothness):
        return np.exp(-(scaled**2) / 2)
    root = np.maximum(np.sqrt(2 * smoothness) * scaled, 1e-10)
    logarithm = (1 - smoothness) * np.log(2) - gammaln(smoothness) + smoothness * np.log(root)
    # The exponentially scaled Bessel function does not vanish where the correlation does not.
    return np.exp(logarithm - root) * kve(smoothness, root)


@compiled
@no_type_check
def entry_of(distance, step, last):
    """Return the entry of a `CovarianceTable` below a distance, and how far it is toward the next."""
    k = min(int(np.sqrt(distance / step)), last - 1)
    return k, min(max((distance / step - k * k) / (2 * k + 1), 0.0), 1.0)


@compiled
@no_type_check
def look_up(distance, step, value, result):
    """Write the covariance at distances."""
    for n in range(len(distance)):
        k, fraction = entry_of(distance[n], step, len(value) - 1)
        result[n] = value[k] + fraction * (value[k + 1] - value[k])


@compiled
@no_type_check
def between(one, other, step, value, result):
    """Write the covariance between the places of windows; value: a table for each window, or one for all."""
    for w in range(len(one)):
        table = value[min(w, len(value) - 1)]
        for i in range(one.shape[1]):
            for j in range(other.shape[1]):
                x, y = one[w, i, 0] - other[w, j, 0], one[w, i, 1] - other[w, j, 1]
                k, fraction = entry_of(np.sqrt(x * x + y * y), step, len(table) - 1)
                result[w, i, j] = table[k] + fraction * (table[k + 1] - table[k])
