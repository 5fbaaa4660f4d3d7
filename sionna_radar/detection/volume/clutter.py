"""Mean echo and motion of volume clutter (rain, snowfall, dust), estimated from the survey itself.

Rain has the same mean profile in every pulse; ground does not. A subsample of the survey's pulses gives the
profile: near the radar a volume that fills the beam falls as r^-2, and exceeds the receiver noise in the
median of the pulses. This first guess locates the end of the volume in each pulse (`end`); the cells well before
it hold volume only, and their average over all pulses is the mean in every cell, regularized by the law where few
reach. The rain rate and the ground need not be known beforehand. Where a volume varies over the survey (a shower at
its edge), its strength around each pulse follows from cells before the ground.

The motion is estimated from the survey as well: drops fall, and the wind carries them. Motion shifts the range measured
by an FMCW sweep by s metres for each m/s of range rate, of near drops as of far ones. So the mean at the measured range
x, in a pulse whose boresight is b and through a volume of the velocity v, is

    mu(x) = k (r^2 + r_n^2)^-1 exp(-a r) + n,       r = x - s (b . v + the platform's range rate),

with the two-way attenuation a, the receiver noise n and the antenna's near field r_n (`near_field_m`). The
information on a range shift in a cell is (d log mean / dr)^2, with a slope of 2 / r + a far away: some hundred pulses
determine the range rate to half a metre a second, and a scan samples many directions. (The end of the volume at the
ground is shifted as well, but stands out in the tails of the ground's echo only, which is hundreds of times as strong:
the footprint's shape would have to be known to a percent there.) The prior is rain falling through still air, drops
weighted by their echo; its rate follows from the strength of the echo where the transmitted power is known. Rain in
still air, snowfall, suspended particles and each of them in a wind are compared by their probabilities, the unknown
velocity integrated out (Laplace's approximation; MacKay 1992, Neural Comput. 4).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import brentq, minimize_scalar
from scipy.special import betaincinv, gammainccinv

from sionna_radar.foundation.numerics import MAX_SPECKLE
from sionna_radar.weather.drops import marshall_palmer
from sionna_radar.weather.rain import NEPERS_PER_DB, echo_speeds, rain_attenuation_db_per_km, rain_reflectivity_per_m

# Cells next to the radar in which a volume is searched, a quarter of them where the ground is near, and its minimum
# power there over the noise.
NEAR_CELLS = 24
MIN_OVER_NOISE = 2.0
# In a volume, power times r^2 is the same in the nearer and the farther half of these cells, up to this factor.
MAX_UNEVEN = 3.0
# Fraction of cells assumed to hold noise only.
QUIET_QUANTILE = 0.05
# Weight of the law, in looks.
LOOKS_OF_LAW = 200.0
# Limits of the law: deviation from the first guess in nepers, and two-way loss in nepers per metre (110 dB/km).
MAX_NEPERS, MAX_LOSS = 6.0, 0.05
# Estimates far below the noise are random: lower limit of the mean, as a fraction of the law.
MIN_OF_LAW = 0.05
# Strength of the volume around a pulse: pulses on each side that enter the estimate, and its limits.
NEIGHBOURS = 12
STRENGTH_LIMITS = (0.01, 100.0)
# Variance between pulses must exceed that of speckle by this factor to be ascribed to the volume.
MIN_UNEVEN = 1.5


def speckle_quantile(probability: float, looks: int = 1) -> float:
    """Return the power over its mean that speckle exceeds with a probability, as the mean of independent looks."""
    return float(-np.log(probability) if looks == 1 else gammainccinv(looks, probability) / looks)


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

    @property
    def farther(self) -> Int[np.ndarray, " cell"]:
        """Farther half of the near cells."""
        return np.arange(sum(self.near) // 2, self.near[1])

    def clutter_threshold(self, false_alarm_probability: float, looks: int = 1) -> Float[np.ndarray, " cell"]:
        """Return the power that volume and noise alone exceed with a given probability: a clutter-map threshold.

        looks: powers averaged in each cell, of drops that have moved in between.
        """
        return speckle_quantile(false_alarm_probability, looks) * self.background

    def strength(
        self, power: Float[np.ndarray, "pulse cell"], looks: float, neighbours: int
    ) -> Float[np.ndarray, " pulse"]:
        """Return the volume's mean around each pulse over that of the survey, from the farther half of the near cells.

        There the shift of ranges by motion, which differs between pulses, is small beside the range.
        looks: independent looks per cell; neighbours: pulses on each side through nearly the same volume.
        """
        if self.uneven == 0:
            return np.ones(len(power))
        kernel = np.ones(2 * neighbours + 1)
        about = slice(neighbours, neighbours + len(power))
        count = np.convolve(np.ones(len(power)), kernel)[about]
        mean = np.convolve(self._near_mean(power), kernel)[about] / count
        chance = 1 / (count * looks * max(self.farther.size, 1))
        # Shrink towards the survey's mean as far as speckle explains the difference.
        weight = self.uneven / (self.uneven + chance * np.maximum(mean, 0.1) ** 2)
        return np.clip(1 + weight * (mean - 1), *STRENGTH_LIMITS)

    def unevenness(self, power: Float[np.ndarray, "pulse cell"], looks: float, smoothed_cells: int) -> float:
        """Return the variance of the volume's strength between pulses in excess of speckle."""
        if self.farther.size < smoothed_cells:
            return 0.0
        mean = self._near_mean(power)
        chance = float(np.mean(mean**2)) / (looks * self.farther.size + 1)
        variance = float(mean.var())
        return variance - chance if variance > MIN_UNEVEN * chance else 0.0

    def _near_mean(self, power: Float[np.ndarray, "pulse cell"]) -> Float[np.ndarray, " pulse"]:
        ratio = power[:, self.farther] / self.background[self.farther]
        return np.minimum(ratio, MAX_SPECKLE * max(1.0, float(np.median(ratio)))).mean(axis=1)


def first_guess(
    power: Float[np.ndarray, "pulse cell"],
    range_m: Float[np.ndarray, " cell"],
    first: int,
    last: int,
    narrow: bool = False,
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
    narrow:
        Whether an echo of the ground is shorter than a range cell: then a volume before near ground is told, too.

    """
    # A volume over part of the survey shows in the strongest pulses only.
    for quantile in (0.5, 0.8):
        volume = _volume_at(quantile, power, range_m, first, last)
        if volume is not None:
            return volume
    return _before_near_ground(power, range_m, first, last) if narrow else None


def _before_near_ground(
    power: Float[np.ndarray, "pulse cell"], range_m: Float[np.ndarray, " cell"], first: int, last: int
) -> VolumeClutter | None:
    """Return the volume that fills the first cells of nearly every pulse, in which the ground may lie, too.

    The nearer half of them shows the law r^-2. The ground only adds power; without a volume its echo, of varying range,
    leaves cells of every pulse empty, whereas the least of n exponential powers has the n-th part of their mean.
    """
    count = NEAR_CELLS // 4
    level = np.median(power, axis=0) / np.log(2)
    noise = float(np.quantile(level[first:last], QUIET_QUANTILE))
    floor = MIN_OVER_NOISE * noise / _quietest(0.5, len(power))
    # The nearest drops may be moved away from the radar, too.
    for start in (first, first + count // 2):
        cells = slice(start, start + count)
        compensated = (power[:, cells] - noise) * range_m[cells] ** 2
        nearer = np.median(compensated[:, : count // 2], axis=0) / np.log(2)
        strength, least = float(np.median(nearer)), count * float(np.median(compensated.min(axis=1))) / np.log(2)
        filled = level[cells][: count // 2].min() >= floor and strength < MAX_UNEVEN * least
        if filled and nearer.max() < MAX_UNEVEN * nearer.min():
            return VolumeClutter(mean=strength / np.maximum(range_m, range_m[1]) ** 2, noise=noise)
    return None


def _volume_at(
    fraction: float, power: Float[np.ndarray, "pulse cell"], range_m: Float[np.ndarray, " cell"], first: int, last: int
) -> VolumeClutter | None:
    """Return the volume whose mean follows from a quantile of the pulses' powers, taken as exponential.

    None as well where the tested cells are too few to show the law.
    """
    if last - first < NEAR_CELLS:
        return None
    level = np.quantile(power, fraction, axis=0) / -np.log(1 - fraction)
    noise = float(np.quantile(level[first:last], QUIET_QUANTILE))
    floor = noise / _quietest(fraction, len(power))
    compensated = (level - noise) * range_m**2
    # Where drops blow towards the radar, the nearest have negative beat frequencies, which a real beat folds onto the
    # first cells; the cells behind follow the law.
    for start in range(first, last - NEAR_CELLS + 1, NEAR_CELLS)[:2]:
        near, far = slice(start, start + NEAR_CELLS // 2), slice(start + NEAR_CELLS // 2, start + NEAR_CELLS)
        strength = float(np.median(compensated[near.start : far.stop]))
        nearest = float(np.median(compensated[first : first + NEAR_CELLS // 2]))
        ratio = float(np.median(compensated[near]) / max(np.median(compensated[far]), np.finfo(float).tiny))
        over = float(np.median(level[near]) / max(floor, np.finfo(float).tiny))
        filled = over >= MIN_OVER_NOISE and strength > 0 and nearest * MAX_UNEVEN > strength
        if filled and 1 / MAX_UNEVEN < ratio < MAX_UNEVEN:
            return VolumeClutter(mean=strength / np.maximum(range_m, range_m[1]) ** 2, noise=noise)
    return None


def _quietest(fraction: float, pulses: int) -> float:
    """Return the noise that the quietest cells seem to hold, over that which all of them hold.

    A quantile of the powers of few pulses scatters from cell to cell: of exponential powers its probability has the
    distribution of an order statistic, a beta distribution.
    """
    rank = fraction * (pulses - 1) + 1
    return float(np.log1p(-betaincinv(rank, pulses + 1 - rank, QUIET_QUANTILE)) / np.log1p(-fraction))


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
        signal_fraction = mean / (mean + guess.noise)
        weight = np.where(observed, count * signal_fraction**2, 0.0)
        excess = np.where(observed, total / np.maximum(count, 1.0) / mean - 1, 0.0)
        design = np.column_stack([np.ones(len(reach)), -reach])
        normal = design.T @ (weight[:, None] * design) + np.diag([1e-9, 1e-9])
        step = np.clip(np.linalg.solve(normal, design.T @ (weight * excess)), [-1.0, -0.05], [1.0, 0.05])
        k, loss = float(np.clip(k + step[0], -MAX_NEPERS, MAX_NEPERS)), float(np.clip(loss + step[1], 0, MAX_LOSS))
    return guess.mean * np.exp(k - loss * reach)


def law_information(volume: VolumeClutter, count: Int[np.ndarray, " cell"], looks: float, cell: int) -> float:
    """Return the Fisher information on the law's mean at a cell, in nepers, from so many pulses in each of the cells.

    The law's slope is unknown, too: from the same pulses.
    """
    weight = looks * count * (volume.mean / volume.background) ** 2
    away = np.arange(len(weight)) - float(cell)
    mean, both, slope = weight.sum(), weight @ away, weight @ away**2
    return float(max(mean - both**2 / slope, 0.0)) if slope > 0 else 0.0


# Of drops, whose mean fall speed at 77 GHz is 4.1 m/s in rain of 1 mm/h and 4.9 m/s in 25 mm/h.
TYPICAL_TEMPERATURE_K = 283.0
# Rain rate where neither the scenario nor the strength of the echo gives it, and limits of the latter.
TYPICAL_RATE_MM_PER_H = 5.0
RATES_MM_PER_H = (0.5, 150.0)
# Snowflakes fall at 0.8 to 1.5 m/s whatever their size (Locatelli and Hobbs 1974, J. Geophys. Res. 79, 2185).
SNOW_FALL_MPS = 1.1
# Standard deviations of the fall about the expected one, and of each horizontal component of the wind.
FALL_SIGMA_MPS = 0.5
WIND_SIGMA_MPS = 5.0
# Relative spread of the fall speed: drops fall at 2 to 7 m/s with a mean of 4.5 m/s.
FALL_SPREAD = 0.22
# Standard deviation of the attenuation about that of the rain, and of the volume's change over the cells.
ATTENUATION_SPREAD, CHANGE_NEPERS = 0.3, 0.1
# Largest speed of particles blown by a storm.
STORM_MPS = 25.0
# Largest step of an iteration in velocity and in the logarithm of the strength, anywhere, and the fraction of it below
# which steps end.
MAX_STEP, MIN_STEP, MAX_STEPS = 5.0, 2e-5, 30


@dataclass(frozen=True, kw_only=True, eq=False)
class VolumeMotion:
    """Mean velocity of the volume's particles, in world axes, and the standard deviation of their fall speed.

    covariance: of the error of that velocity, (m/s)^2.
    """

    velocity_mps: Float[np.ndarray, " 3"]
    fall_spread_mps: float
    covariance: Float[np.ndarray, "3 3"]

    def range_rate_mps(self, boresight: Float[np.ndarray, "pulse 3"]) -> Float[np.ndarray, " pulse"]:
        """Return the range rate of the volume along each boresight for a stationary radar, m/s (receding positive)."""
        return boresight @ self.velocity_mps

    def sigma_mps(self, boresight: Float[np.ndarray, "pulse 3"]) -> Float[np.ndarray, " pulse"]:
        """Return the standard deviation of the error of that range rate, m/s."""
        return np.asarray(np.sqrt(np.einsum("pi,ij,pj->p", boresight, self.covariance, boresight)))


def rain_rate_of(reflectivity_per_m: float, range_m: float, carrier_hz: float) -> float:
    """Return the rain rate (mm/h) whose Marshall-Palmer drops appear with this reflectivity behind so much of the rain.

    reflectivity_per_m: m2/m3, of the echo as received; the loss of rain (ITU-R P.838) over the range reduces it. From
    afar heavier rain appears weaker: of two rates the lesser is returned, and beyond any rain's that of the strongest.
    """

    def excess(log_rate: float) -> float:
        rate, loss = math.exp(log_rate), {"elevation_rad": -math.pi / 2, "tilt_rad": 0.0}
        rain = rain_reflectivity_per_m(carrier_hz, rain_rate_mm_per_h=rate, temperature_k=TYPICAL_TEMPERATURE_K)
        loss_db_per_km = rain_attenuation_db_per_km(carrier_hz, rain_rate_mm_per_h=rate, **loss)
        return math.log(rain / reflectivity_per_m) - NEPERS_PER_DB * 2e-3 * range_m * loss_db_per_km

    least, most = np.log(RATES_MM_PER_H)
    tolerance = 1e-3
    if excess(most) < excess(most - tolerance):
        most = float(minimize_scalar(lambda log_rate: -excess(log_rate), bounds=(least, most), method="bounded").x)
    if excess(least) >= 0 or excess(most) <= 0:
        return math.exp(least if excess(least) >= 0 else most)
    return math.exp(brentq(excess, least, most, xtol=tolerance))


def expected_motion(carrier_hz: float, rain_rate_mm_per_h: float) -> VolumeMotion:
    """Return the motion of rain in still air, drops weighted by their echo at the carrier; a wind is as likely."""
    fall_mps = _rain_fall_mps(carrier_hz, rain_rate_mm_per_h)
    return VolumeMotion(
        velocity_mps=np.array([0.0, 0.0, -fall_mps]),
        fall_spread_mps=FALL_SPREAD * fall_mps,
        covariance=np.diag([WIND_SIGMA_MPS**2 / 2, WIND_SIGMA_MPS**2 / 2, FALL_SIGMA_MPS**2]),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class VolumeCells:
    """Cells that hold nothing but volume, in pulses sampled over a survey.

    power: over the volume's strength around each pulse. noise: mean power of the receiver noise, likewise.
    range_m: measured ranges of the cells. shift_m: increase of a range for each m/s of range rate.
    boresight, platform_mps: boresights, and the platform's range rates along them, of the measured poses.
    looks: independent looks per cell. margin_m: reach of an echo's side lobes. near_field_m: of the antenna.
    uneven: variance of the volume's strength between pulses, and so along a beam; 0 if it is uniform.
    """

    power: Float[np.ndarray, "pulse cell"]
    noise: Float[np.ndarray, "pulse 1"]
    range_m: Float[np.ndarray, " cell"]
    shift_m: float
    boresight: Float[np.ndarray, "pulse 3"]
    platform_mps: Float[np.ndarray, " pulse"]
    looks: float
    margin_m: float
    near_field_m: float
    uneven: float

    def beyond(self, particles_mps: Float[np.ndarray, " pulse"] | float) -> "VolumeCells":
        """Return the cells that no shift by particles of up to some range rates brings the nearest particles into.

        Approaching ones next to the radar have negative beat frequencies, which a real signal shows as positive ones.
        """
        shift_m = abs(self.shift_m) * float(np.max(np.abs(self.platform_mps) + particles_mps))
        far = self.range_m >= self.margin_m + shift_m
        return replace(self, power=self.power[:, far], range_m=self.range_m[far])


def estimated_motion(carrier_hz: float, rain_rate_mm_per_h: float, cells: VolumeCells) -> VolumeMotion:
    """Return the most probable motion; its covariance is that about it of all kinds of motion, by their probabilities.

    Parameters
    ----------
    carrier_hz:
        Carrier, which determines the echo weight of each drop size.
    rain_rate_mm_per_h:
        Expected rain.
    cells:
        Cells before the ground.

    """
    rain = expected_motion(carrier_hz, rain_rate_mm_per_h)
    falls_mps = (-float(rain.velocity_mps[2]), SNOW_FALL_MPS, 0.0)
    straight_down = {"elevation_rad": -math.pi / 2, "tilt_rad": 0.0}
    loss_db_per_km = rain_attenuation_db_per_km(carrier_hz, rain_rate_mm_per_h=rain_rate_mm_per_h, **straight_down)
    attenuation = 2e-3 * NEPERS_PER_DB * loss_db_per_km
    used = cells.beyond(STORM_MPS)
    if used.range_m.size < 2:
        return rain
    # A storm could reach farther than the motion found does: nearer cells tell it better.
    while True:
        wind, _ = _fitted_motion(used, falls_mps[0], attenuation, still=False)
        nearer = cells.beyond(np.abs(wind.range_rate_mps(cells.boresight)) + 3 * wind.sigma_mps(cells.boresight))
        if nearer.range_m.size <= used.range_m.size:
            break
        used = nearer
    fits = [_fitted_motion(used, fall, attenuation, still=still) for still in (True, False) for fall in falls_mps]
    # Rain in still air is beforehand as probable as all others together.
    cost = np.array([cost for _, cost in fits]) + math.log(len(fits) - 1) * (np.arange(len(fits)) > 0)
    best, probability = fits[int(np.argmin(cost))][0], np.exp(cost.min() - cost)
    apart_mps = [motion.velocity_mps - best.velocity_mps for motion, _ in fits]
    spread = [motion.covariance + np.outer(apart, apart) for (motion, _), apart in zip(fits, apart_mps, strict=True)]
    return replace(best, covariance=np.average(spread, axis=0, weights=probability))


def _fitted_motion(
    cells: VolumeCells, fall_mps: float, attenuation: float, *, still: bool
) -> tuple[VolumeMotion, float]:
    """Return the most probable motion of one kind, and the negative logarithm of its probability.

    The velocity is sought about a fall, by Fisher scoring, with strength and attenuation free.

    attenuation: expected, two-way, nepers/m. still: the particles fall as expected.
    """
    extent_m = max(float(np.ptp(cells.range_m)), cells.margin_m)
    spread = np.hypot(ATTENUATION_SPREAD * attenuation, math.hypot(CHANGE_NEPERS, math.sqrt(cells.uneven)) / extent_m)
    # Cells of an uneven volume differ from the law together.
    looks = cells.looks / (1 + cells.looks * cells.range_m.size * cells.uneven)
    expected = np.array([0.0, 0.0, -fall_mps, 0.0, attenuation])
    precision = np.array([WIND_SIGMA_MPS**-2, WIND_SIGMA_MPS**-2, FALL_SIGMA_MPS**-2, MAX_NEPERS**-2, spread**-2])
    at_rest = cells.range_m - cells.shift_m * cells.platform_mps[:, None]
    nearest_m = float(np.diff(cells.range_m[:2])[0])

    def law(value: Float[np.ndarray, " 5"]) -> tuple[Float[np.ndarray, "pulse cell"], Float[np.ndarray, "pulse cell"]]:
        range_m = np.maximum(at_rest - cells.shift_m * (cells.boresight @ value[:3])[:, None], nearest_m)
        return range_m, np.exp(value[3] - value[4] * range_m) / (range_m**2 + cells.near_field_m**2)

    def loss(value: Float[np.ndarray, " 5"]) -> float:
        mean = law(value)[1] + cells.noise
        return float(
            looks * np.sum(np.log(mean) + cells.power / mean) + np.sum(precision * (value - expected) ** 2) / 2
        )

    value = expected.copy()
    noise = float(np.mean(cells.noise))
    received = max(float(np.mean(cells.power)) - noise, MIN_OF_LAW * noise, np.finfo(float).tiny)
    value[3] = expected[3] = math.log(received / float(np.mean(law(value)[1])))
    free = slice(3, 5) if still else slice(0, 5)
    limit = MAX_STEP / np.array([1.0, 1.0, 1.0, 1.0, float(cells.range_m[-1])])
    cost = loss(value)
    for _ in range(MAX_STEPS):
        range_m, volume = law(value)
        mean = volume + cells.noise
        signal_fraction = volume / mean
        by_rate = signal_fraction * (2 * range_m / (range_m**2 + cells.near_field_m**2) + value[4]) * cells.shift_m
        slopes = np.stack(
            [*(cells.boresight.T[:, :, None] * by_rate), signal_fraction, -range_m * signal_fraction]
        ).reshape(5, -1)
        information = looks * slopes @ slopes.T + np.diag(precision)
        score = looks * slopes @ (cells.power / mean - 1).ravel() - precision * (value - expected)
        step = np.zeros(5)
        step[free] = np.linalg.solve(information[free, free], score[free])
        step /= max(np.abs(step / limit).max(), 1.0)
        # Where powers are far above the law, a full step goes beyond them.
        while (moved := loss(value + step)) > cost and np.abs(step / limit).max() >= MIN_STEP:
            step /= 2
        value, cost = value + step, moved
        if np.abs(step / limit).max() < MIN_STEP:
            break
    cost += (np.linalg.slogdet(information[free, free])[1] - (0.0 if still else np.log(precision[:3]).sum())) / 2
    motion = VolumeMotion(
        velocity_mps=value[:3],
        fall_spread_mps=FALL_SPREAD * max(-float(value[2]), 0.0),
        covariance=np.diag([0.0, 0.0, FALL_SIGMA_MPS**2]) if still else np.linalg.inv(information)[:3, :3],
    )
    return motion, cost


def _rain_fall_mps(carrier_hz: float, rate_mm_per_h: float) -> float:
    speeds = echo_speeds(carrier_hz, drops=marshall_palmer(rate_mm_per_h), temperature_k=TYPICAL_TEMPERATURE_K)
    return float(np.mean(speeds.at((np.arange(200) + 0.5) / 200)))
