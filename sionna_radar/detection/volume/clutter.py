"""The mean echo and the motion of a volume (rain, snowfall, dust), estimated from the survey that it contaminates.

Rain has the same mean profile in every pulse; ground does not. A subsample of the survey's pulses gives the
profile: near the radar a volume that fills the beam falls as r^-2, and exceeds the receiver noise in the
median of the pulses. This first guess locates the end of the volume in each pulse (`end`); the cells well before
it hold volume only, and their average over all pulses is the mean in every cell, regularized by the law where few
reach. The rain rate and the ground need not be known beforehand. Where a volume varies over the survey (a shower at
its edge), its strength around each pulse follows from the cells next to the radar.

The motion is estimated from the survey as well: drops fall, and the wind carries them. Motion shifts the range measured
by an FMCW sweep, so that the end of the volume appears beside the echo of the ground that ends it. The shift in each
pulse depends on the mean velocity of the particles along its boresight; a scan samples many directions. The prior
is rain falling through still air, drops weighted by their echo; its rate follows from the strength of the
echo where the transmitted power is known. Snow, fog or a wind are accepted if they raise the
total likelihood by more than a model error does: over simulated ground the maximum-likelihood speed is up to 1 m/s off
the true one.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, minimize

from sionna_radar.foundation.numerics import MAX_SPECKLE
from sionna_radar.weather.drops import marshall_palmer
from sionna_radar.weather.rain import NEPERS_PER_DB, echo_speeds, rain_attenuation_db_per_km, rain_reflectivity_per_m

# Cells next to the radar in which a volume is searched, and its minimum power there over the noise.
NEAR_CELLS = 24
MIN_OVER_NOISE = 2.0
# In a volume, power times r^2 is the same in the nearer and the farther half of these cells, up to this factor.
MAX_UNEVEN = 3.0
# Share of cells assumed to hold noise only.
QUIET_SHARE = 0.05
# Weight of the law, in looks.
LOOKS_OF_LAW = 200.0
# Limits of the law: deviation from the first guess in nepers, and two-way loss in nepers per metre (110 dB/km).
MAX_NEPERS, MAX_LOSS = 6.0, 0.05
# Estimates far below the noise are random: lower limit of the mean, as a share of the law.
MIN_OF_LAW = 0.05
# Strength of the volume around a pulse: pulses on each side that enter the estimate, and its limits.
NEIGHBOURS = 12
STRENGTH_LIMITS = (0.01, 100.0)
# Variance between pulses must exceed that of speckle by this factor to be ascribed to the volume.
MIN_UNEVEN = 1.5


@dataclass(frozen=True, kw_only=True, eq=False)
class VolumeClutter:
    """Mean powers of a volume in the range cells, as if without ground.

    mean: power of the volume; noise: power of the receiver noise, one for all cells.
    near: first, and one past the last, of the cells that hold volume only in nearly every pulse.
    uneven: variance of the volume's strength between pulses; 0 if it is uniform.
    """

    mean: Float[np.ndarray, " cell"]
    noise: float
    near: tuple[int, int] = (0, 0)
    uneven: float = 0.0

    @property
    def background(self) -> Float[np.ndarray, " cell"]:
        """Mean power of volume and noise."""
        return self.mean + self.noise

    def clutter_threshold(self, false_alarm_probability: float) -> Float[np.ndarray, " cell"]:
        """Return the power that volume and noise alone exceed with a given probability: a clutter-map threshold."""
        return -np.log(false_alarm_probability) * self.background

    def strength(
        self, power: Float[np.ndarray, "pulse cell"], looks: float, neighbours: int
    ) -> Float[np.ndarray, " pulse"]:
        """Return the volume's mean around each pulse over that of the survey, from the cells next to the radar.

        looks: independent looks per cell; neighbours: pulses on each side through nearly the same volume.
        """
        if self.uneven == 0:
            return np.ones(len(power))
        kernel = np.ones(2 * neighbours + 1)
        about = slice(neighbours, neighbours + len(power))
        count = np.convolve(np.ones(len(power)), kernel)[about]
        mean = np.convolve(self._near_mean(power), kernel)[about] / count
        chance = 1 / (count * looks * max(self.near[1] - self.near[0], 1))
        # Shrink towards the survey's mean as far as speckle explains the difference.
        share = self.uneven / (self.uneven + chance * np.maximum(mean, 0.1) ** 2)
        return np.clip(1 + share * (mean - 1), *STRENGTH_LIMITS)

    def unevenness(self, power: Float[np.ndarray, "pulse cell"], looks: float, smoothed_cells: int) -> float:
        """Return the variance of the volume's strength between pulses in excess of speckle."""
        cells = self.near[1] - self.near[0]
        if cells < 2 * smoothed_cells:
            return 0.0
        mean = self._near_mean(power)
        chance = float(np.mean(mean**2)) / (looks * cells + 1)
        variance = float(mean.var())
        return variance - chance if variance > MIN_UNEVEN * chance else 0.0

    def _near_mean(self, power: Float[np.ndarray, "pulse cell"]) -> Float[np.ndarray, " pulse"]:
        cells = slice(*self.near)
        ratio = power[:, cells] / self.background[cells]
        return np.minimum(ratio, MAX_SPECKLE * max(1.0, float(np.median(ratio)))).mean(axis=1)


def first_guess(
    power: Float[np.ndarray, "pulse cell"], range_m: Float[np.ndarray, " cell"], first: int, last: int
) -> VolumeClutter | None:
    """Return a volume whose echo falls as r^-2 from the radar; None in clear air.

    Parameters
    ----------
    power:
        Powers of pulses sampled over the survey.
    range_m:
        Ranges of the cells.
    first, last:
        Limits of the tested cells.

    """
    # A volume over part of the survey shows in the strongest pulses only.
    for share in (0.5, 0.8):
        volume = _volume_at(share, power, range_m, first, last)
        if volume is not None:
            return volume
    return None


def _volume_at(
    share: float, power: Float[np.ndarray, "pulse cell"], range_m: Float[np.ndarray, " cell"], first: int, last: int
) -> VolumeClutter | None:
    """Return the volume whose mean follows from a quantile of the pulses' powers, taken as exponential."""
    level = np.quantile(power, share, axis=0) / -np.log(1 - share)
    noise = float(np.quantile(level[first:last], QUIET_SHARE))
    compensated = (level - noise) * range_m**2
    # Where drops blow towards the radar, the nearest have negative beat frequencies, which a real beat folds onto the
    # first cells; the cells behind follow the law.
    for start in (first, first + NEAR_CELLS):
        near, far = slice(start, start + NEAR_CELLS // 2), slice(start + NEAR_CELLS // 2, min(start + NEAR_CELLS, last))
        strength = float(np.median(compensated[near.start : far.stop]))
        nearest = float(np.median(compensated[first : first + NEAR_CELLS // 2]))
        ratio = float(np.median(compensated[near]) / max(np.median(compensated[far]), np.finfo(float).tiny))
        over = float(np.median(level[near]) / max(noise, np.finfo(float).tiny))
        filled = over >= MIN_OVER_NOISE and strength > 0 and nearest * MAX_UNEVEN > strength
        if filled and 1 / MAX_UNEVEN < ratio < MAX_UNEVEN:
            return VolumeClutter(mean=strength / np.maximum(range_m, range_m[1]) ** 2, noise=noise)
    return None


def measured_mean(
    guess: VolumeClutter,
    power: Float[np.ndarray, "pulse cell"],
    volume_only: Bool[np.ndarray, "pulse cell"],
    range_m: Float[np.ndarray, " cell"],
    smoothed_cells: int,
) -> Float[np.ndarray, " cell"]:
    """Return the volume's mean from the volume-only cells; where these are few, the law fitted to them."""
    clipped = np.minimum(power, MAX_SPECKLE * guess.background) - guess.noise
    count = volume_only.sum(axis=0).astype(float)
    total = np.where(volume_only, clipped, 0.0).sum(axis=0)
    law = _law(guess, total, count, range_m)
    kernel = np.ones(2 * smoothed_cells + 1)
    smoothed = np.convolve(total / law, kernel, "same") + LOOKS_OF_LAW
    return law * np.maximum(smoothed / (np.convolve(count, kernel, "same") + LOOKS_OF_LAW), MIN_OF_LAW)


def _law(
    guess: VolumeClutter,
    total: Float[np.ndarray, " cell"],
    count: Float[np.ndarray, " cell"],
    range_m: Float[np.ndarray, " cell"],
) -> Float[np.ndarray, " cell"]:
    """Return k r^-2 exp(-a r) with the most likely k and a, by Fisher scoring of exponential powers."""
    observed = count > 0
    k, loss = 0.0, 0.0
    reach = range_m - range_m[observed].mean() if observed.any() else range_m
    for _ in range(12):
        mean = guess.mean * np.exp(k - loss * reach)
        # Weight of a cell: sensitivity of its mean to the volume's, given the receiver noise.
        share = mean / (mean + guess.noise)
        weight = np.where(observed, count * share**2, 0.0)
        excess = np.where(observed, total / np.maximum(count, 1.0) / mean - 1, 0.0)
        design = np.column_stack([np.ones(len(reach)), -reach])
        normal = design.T @ (weight[:, None] * design) + np.diag([1e-9, 1e-9])
        step = np.clip(np.linalg.solve(normal, design.T @ (weight * excess)), [-1.0, -0.05], [1.0, 0.05])
        k, loss = float(np.clip(k + step[0], -MAX_NEPERS, MAX_NEPERS)), float(np.clip(loss + step[1], 0, MAX_LOSS))
    return guess.mean * np.exp(k - loss * reach)


# Of drops, whose mean fall speed at 77 GHz is 4.1 m/s in rain of 1 mm/h and 4.9 m/s in 25 mm/h.
TYPICAL_TEMPERATURE_K = 283.0
# Rain rate where neither the scenario nor the strength of the echo tells it, and limits of the latter.
TYPICAL_RATE_MM_PER_H = 5.0
RATES_MM_PER_H = (0.5, 150.0)
# Snowflakes fall at 0.8 to 1.5 m/s whatever their size (Locatelli and Hobbs 1974, J. Geophys. Res. 79, 2185).
SNOW_FALL_MPS = 1.1
# Another motion must exceed the likelihood of rain in still air by more than this error in radial speed costs,
# and by more nepers per pulse than weak ground causes at random.
MODEL_ERROR_MPS = 1.4
MIN_GAIN = 0.1
# Standard deviations of the fall about the expected one, and of each horizontal component of the wind.
FALL_SIGMA_MPS = 0.5
WIND_SIGMA_MPS = 5.0
# Relative spread of the fall speed: drops fall at 2 to 7 m/s with a mean of 4.5 m/s.
FALL_SPREAD = 0.22
# Radial speeds at which pulses are compared.
RADIAL_SPEEDS_MPS = np.arange(-10.0, 15.0, 2.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class VolumeMotion:
    """Mean velocity of the volume's particles, in world axes, and the standard deviation of their fall speed."""

    velocity_mps: Float[np.ndarray, " 3"]
    fall_spread_mps: float

    def range_rate_mps(self, boresight: Float[np.ndarray, "pulse 3"]) -> Float[np.ndarray, " pulse"]:
        """Return the range rate of the volume along each boresight for a stationary radar, m/s (receding positive)."""
        return boresight @ self.velocity_mps


def falling(fall_mps: float) -> VolumeMotion:
    """Return the motion of a volume falling through still air."""
    return VolumeMotion(velocity_mps=np.array([0.0, 0.0, -fall_mps]), fall_spread_mps=FALL_SPREAD * fall_mps)


def rain_rate_of(reflectivity_per_m: float, range_m: float, carrier_hz: float) -> float:
    """Return the rain rate (mm/h) whose Marshall-Palmer drops appear with this reflectivity behind so much of the rain.

    reflectivity_per_m: m2/m3, of the echo as received; the loss of rain (ITU-R P.838) over the range reduces it.
    """

    def excess(log_rate: float) -> float:
        rate, loss = math.exp(log_rate), {"elevation_rad": -math.pi / 2, "tilt_rad": 0.0}
        rain = rain_reflectivity_per_m(carrier_hz, rain_rate_mm_per_h=rate, temperature_k=TYPICAL_TEMPERATURE_K)
        loss_db_per_km = rain_attenuation_db_per_km(carrier_hz, rain_rate_mm_per_h=rate, **loss)
        return math.log(rain / reflectivity_per_m) - NEPERS_PER_DB * 2e-3 * range_m * loss_db_per_km

    least, most = np.log(RATES_MM_PER_H)
    if excess(least) >= 0 or excess(most) <= 0:
        return RATES_MM_PER_H[0] if excess(least) >= 0 else RATES_MM_PER_H[1]
    return math.exp(brentq(excess, least, most, xtol=1e-3))


def expected_motion(carrier_hz: float, rain_rate_mm_per_h: float) -> VolumeMotion:
    """Return the motion of rain in still air, drops weighted by their echo at the carrier."""
    return falling(_rain_fall_mps(carrier_hz, rain_rate_mm_per_h))


def estimated_motion(
    carrier_hz: float,
    rain_rate_mm_per_h: float,
    boresight: Float[np.ndarray, "pulse 3"],
    likelihood: Callable[[float], Float[np.ndarray, " pulse"]],
) -> VolumeMotion:
    """Return the most probable motion.

    Parameters
    ----------
    carrier_hz:
        Carrier, which determines the echo weight of each drop size.
    rain_rate_mm_per_h:
        Expected rain.
    boresight:
        Boresights of pulses sampled over the survey, from their measured poses.
    likelihood:
        Log-likelihood of each pulse for a volume that recedes from all of them at one speed (m/s).

    """
    by_speed = np.array([likelihood(float(speed)) for speed in RADIAL_SPEEDS_MPS])
    spline = CubicSpline(RADIAL_SPEEDS_MPS, by_speed, bc_type="natural")
    row = np.arange(len(boresight))
    reach = RADIAL_SPEEDS_MPS[[0, -1]]

    def cost(velocity_mps: Float[np.ndarray, " 3"], fall_mps: float) -> float:
        """Return the negative log-posterior; each pulse has its own radial speed and spline."""
        speed = np.clip(boresight @ velocity_mps, *reach)
        interval = np.clip(np.searchsorted(RADIAL_SPEEDS_MPS, speed) - 1, 0, len(RADIAL_SPEEDS_MPS) - 2)
        step = speed - RADIAL_SPEEDS_MPS[interval]
        value = sum(c[interval, row] * step ** (3 - power) for power, c in enumerate(spline.c))
        wind = velocity_mps[:2] @ velocity_mps[:2] / WIND_SIGMA_MPS**2
        return float(-np.sum(value) + (wind + ((velocity_mps[2] + fall_mps) / FALL_SIGMA_MPS) ** 2) / 2)

    def fitted(fall_mps: float) -> tuple[float, VolumeMotion]:
        """Return the best wind and fall around an expected fall speed, and their cost."""
        start = np.array([0.0, 0.0, -fall_mps])
        simplex = start + np.concatenate([np.zeros((1, 3)), np.diag([WIND_SIGMA_MPS, WIND_SIGMA_MPS, FALL_SIGMA_MPS])])
        options = {"initial_simplex": simplex, "xatol": 0.01, "fatol": 0.01}
        best = minimize(cost, start, args=(fall_mps,), method="Nelder-Mead", options=options)
        spread_mps = FALL_SPREAD * max(-float(best.x[2]), 0.0)
        return best.fun, VolumeMotion(velocity_mps=best.x, fall_spread_mps=spread_mps)

    falls = (_rain_fall_mps(carrier_hz, rain_rate_mm_per_h), SNOW_FALL_MPS, 0.0)
    chosen = falling(falls[0])
    lowest_cost = cost(chosen.velocity_mps, falls[0]) - max(
        _loss_by_error(by_speed.sum(axis=1)), MIN_GAIN * len(boresight)
    )
    still_air = [(cost(falling(fall).velocity_mps, fall), falling(fall)) for fall in falls[1:]]
    for value, motion in still_air + [fitted(fall) for fall in falls]:
        if value < lowest_cost:
            lowest_cost, chosen = value, motion
    return chosen


def _loss_by_error(total: Float[np.ndarray, " speed"]) -> float:
    """Return the loss of log-likelihood by a model error, from the curvature at the best radial speed."""
    best = int(np.clip(np.argmax(total), 1, len(total) - 2))
    step_mps = RADIAL_SPEEDS_MPS[1] - RADIAL_SPEEDS_MPS[0]
    return float((total[best] - total[[best - 1, best + 1]].mean()) * (MODEL_ERROR_MPS / step_mps) ** 2)


def _rain_fall_mps(carrier_hz: float, rate_mm_per_h: float) -> float:
    speeds = echo_speeds(carrier_hz, drops=marshall_palmer(rate_mm_per_h), temperature_k=TYPICAL_TEMPERATURE_K)
    return float(np.mean(speeds.at((np.arange(200) + 0.5) / 200)))
