"""What a DEM and its echoes say of the ground together: expected heights, and the correlation of their errors.

A wave of the ground has the prior power S(k), fitted to the echoes' heights; echoes of a density per area, of the noise
N = variance / density, see it through their footprint, F = exp(-(k spread)^2 / 2). The best estimate leaves the power
1 / (1 / S + F^2 / N) (Wiener). So do the maps of most probable surfaces (`smooth`, `refined`, `stepped`), with a noise
by which the integral of that power is the stated variance of their cells: whole echoes have less than mean ranges.

A map of linear interpolation passes signal and noise up to waves of the echoes' spacing d, as H = sinc^2(k d / 2 pi).
Its errors, S (1 - H F)^2 + N H^2, contain the noise that is in the map: ground drawn as the map plus such errors would
have the noise twice, and be too rough. The filter G = S F / (S F^2 + N) makes the best estimate of such a map; with G H
in the place of H the same formula is the power of its errors.
"""

from dataclasses import dataclass

import numpy as np
import scipy.fft
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.special import j0

from sionna_radar.inference.terrain.covariance import Covariance
from sionna_radar.inference.terrain.covariance_fit import fit_covariance
from sionna_radar.inference.terrain.heights import Heights, plane_through
from sionna_radar.inference.terrain.local_relief import low_relief_mask
from sionna_radar.mapping.linear.linear import UNKNOWN_NOISE_FACTOR_SPREAD
from sionna_radar.mapping.options import SMOOTH

# Wavelengths, distances between cells, and range of the logarithm of the factor on the noise.
LONGEST_M, SHORTEST_M, WAVES = 20_000.0, 0.25, 1800
DISTANCES_M = np.concatenate([np.linspace(0.0, 10.0, 101), np.geomspace(10.2, 125.0, 100)])
MAX_LOG_FACTOR = 15.0


@dataclass(frozen=True)
class Correlation:
    """A function of distance: linear between entries, 0 beyond the last; of errors, 1 at distance 0."""

    distance_m: Float[np.ndarray, " entry"]
    value: Float[np.ndarray, " entry"]

    @property
    def length_m(self) -> float:
        """Distance at which it has fallen to 1 / e."""
        below = int(np.argmax(self.value < np.exp(-1)))
        return float(np.interp(-np.exp(-1), -self.value[below - 1 : below + 1], self.distance_m[below - 1 : below + 1]))

    def spectrum(self, shape: tuple[int, int], spacing_m: float) -> Float[np.ndarray, "row column"]:
        """Return its discrete Fourier transform on a periodic grid."""
        north, east = (np.minimum(np.arange(n), n - np.arange(n)) * spacing_m for n in shape)
        value = np.interp(np.hypot(north[:, None], east), self.distance_m, self.value, right=0.0)
        return np.asarray(scipy.fft.fft2(value).real)


def expected_ground(
    height_m: Float[np.ndarray, "row column"],
    sigma_m: Float[np.ndarray, "row column"],
    spacing_m: float,
    heights: Heights,
    method: str,
    microrelief_m: float,
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"], Correlation]:
    """Return expected heights, their standard deviations, and the correlation of their errors.

    height_m, sigma_m, spacing_m, method: of the DEM, NaN where it is empty; its name in a scenario.
    heights: the echoes, as means over footprints. microrelief_m: see `Mapper`.
    """
    measured = heights.above(heights.trend(), microrelief_m)
    kept = measured.rows(low_relief_mask(measured, SMOOTH.window_heights))
    fitted = fit_covariance(kept, 1, UNKNOWN_NOISE_FACTOR_SPREAD)
    k, weight = _waves()
    prior = fitted.covariance.power(k)
    density = len(heights) / float(np.prod(np.maximum(np.ptp(heights.place_m, axis=0), 1.0)))
    foot = np.exp(-((k * float(np.median(heights.spread_m))) ** 2) / 2)
    passed = np.sinc(k / np.sqrt(density) / (2 * np.pi)) ** 2 if method == "linear" else None
    usual = float(np.median(heights.variance_m2(fitted.noise_factor))) / density
    stated_m2 = float(np.nanmedian(sigma_m**2))

    def power(noise: float, passed: Float[np.ndarray, " wave"] | None) -> Float[np.ndarray, " wave"]:
        if passed is None:
            return 1 / (1 / prior + foot**2 / noise)
        return prior * (1 - passed * foot) ** 2 + noise * passed**2

    def excess(log_factor: float) -> float:
        return float(weight @ power(usual * np.exp(log_factor), passed)) - stated_m2

    low, high = -MAX_LOG_FACTOR, MAX_LOG_FACTOR
    solved = brentq(excess, low, high) if excess(low) < 0 < excess(high) else low if excess(low) > 0 else high
    noise = usual * np.exp(solved)
    left = power(noise, passed)
    if passed is not None:
        gain = prior * foot / (prior * foot**2 + noise)
        best = power(noise, gain * passed)
        if weight @ best < weight @ left:
            kernel = Correlation(DISTANCES_M, j0(DISTANCES_M[:, None] * k) @ (weight * gain))
            smooth_m, ratio = filtered(height_m, spacing_m, kernel), np.sqrt(weight @ best / (weight @ left))
            # An isolated hump or hole is no noise, nor what the prior knows: the map stands.
            usual_here = np.abs(height_m - smooth_m) <= SMOOTH.outlier_sigmas * sigma_m
            height_m = np.where(usual_here, smooth_m, height_m)
            sigma_m = np.where(usual_here, ratio, 1.0) * sigma_m
            left = best
    return height_m, sigma_m, _correlation(k, weight * left)


def shortest_correlation(prior: Covariance, sigma_m: Float[np.ndarray, "row column"]) -> Correlation:
    """Return the correlation of errors that vary most within a footprint: for a map of which no echoes are known.

    Of the errors with the stated variance, none of whose waves is higher than the prior's, those are the shortest that
    hold all waves below a length, and none above it.
    """
    k, weight = _waves()
    variance_m2 = weight * prior.power(k)
    shorter_m2 = np.cumsum(variance_m2[::-1])[::-1]
    left_out = shorter_m2 <= max(float(np.nanmedian(sigma_m**2)), float(shorter_m2[-1]))
    return _correlation(k, np.where(left_out, variance_m2, 0.0))


def _waves() -> tuple[Float[np.ndarray, " wave"], Float[np.ndarray, " wave"]]:
    """Return wave numbers, rad/m, and the area of each in the plane of wave vectors, over (2 pi)^2."""
    k = np.geomspace(2 * np.pi / LONGEST_M, 2 * np.pi / SHORTEST_M, WAVES)
    return k, k**2 * np.gradient(np.log(k)) / (2 * np.pi)


def _correlation(k: Float[np.ndarray, " wave"], variance_m2: Float[np.ndarray, " wave"]) -> Correlation:
    """Return the correlation of errors from the variance of each wave."""
    value = j0(DISTANCES_M[:, None] * k) @ variance_m2
    return Correlation(DISTANCES_M, value / value[0])


def filtered(
    height_m: Float[np.ndarray, "row column"], spacing_m: float, kernel: Correlation
) -> Float[np.ndarray, "row column"]:
    """Return heights, less their plane, convolved with a kernel whose weights, over filled cells, sum to one."""
    filled, (rows, columns) = np.isfinite(height_m), height_m.shape
    place = np.argwhere(filled).astype(float)
    trend = plane_through(place, height_m[filled])
    plane_m = trend[0] + trend[1] * np.arange(rows)[:, None] + trend[2] * np.arange(columns)
    transfer = kernel.spectrum((2 * rows, 2 * columns), spacing_m)

    def convolved(values: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        padded = np.zeros(transfer.shape)
        padded[:rows, :columns] = values
        return np.asarray(scipy.fft.ifft2(transfer * scipy.fft.fft2(padded)).real[:rows, :columns])

    with np.errstate(invalid="ignore", divide="ignore"):
        smoothed = convolved(np.where(filled, height_m - plane_m, 0.0)) / convolved(filled.astype(float))
    return np.where(filled, plane_m + smoothed, np.nan)
