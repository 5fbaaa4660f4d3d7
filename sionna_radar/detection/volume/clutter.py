"""The mean echo of a volume (rain, snowfall, dust), estimated from the survey that it contaminates.

Rain has the same mean profile in every pulse; ground does not. Some pulses spread over the survey give the
profile: near the radar a volume that fills the beam falls as r^-2, and exceeds the receiver noise in the
median of the pulses. That first guess shows where each pulse's volume ends (`end`); the cells well before
that hold volume only, and all pulses together give its mean in every cell, regularized by the law where few reach.
The rain rate and the ground need not be known beforehand. Where a volume varies over the survey (a shower at
its edge), its strength around each pulse follows from the cells next to the radar.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

# Cells next to the radar in which a volume is searched, and its least power there over the noise.
NEAR_CELLS = 24
LEAST_OVER_NOISE = 2.0
# In a volume, power times r^2 is the same in the nearer and the farther half of these cells, up to this factor.
MOST_UNEVEN = 3.0
# Share of cells that certainly hold noise only.
QUIET_SHARE = 0.05
# Cells over which the estimate is smoothed, each way, and the weight of the law in looks.
SMOOTHED_CELLS = 8
LOOKS_OF_LAW = 200.0
# How far the law may differ from the first guess, in nepers, and its two-way loss in nepers per metre (110 dB/km).
MOST_NEPERS, MOST_LOSS = 6.0, 0.05
# Estimates of a volume far below the noise are random: the mean is at least this share of the law.
LEAST_OF_LAW = 0.05
# One in 3000 exponential powers exceeds 8 means: anything stronger is not the volume.
MOST_OVER_MEAN = 8.0
# Strength of the volume around a pulse: pulses on each side that enter the estimate, and its limits.
NEIGHBOURS = 12
STRENGTH_LIMITS = (0.01, 100.0)
# Variance between pulses must exceed that of speckle by this factor to be ascribed to the volume.
LEAST_UNEVEN = 1.5


@dataclass(frozen=True, kw_only=True, eq=False)
class VolumeClutter:
    """Mean powers of a volume in the range cells, as if no ground ended it.

    mean: power of the volume; noise: power of the receiver noise, one for all cells.
    near: first and one past the last of the cells that hold only the volume in nearly every pulse.
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

        looks: independent looks per cell; neighbours: pulses on each side that see nearly the same volume.
        """
        if self.uneven == 0:
            return np.ones(len(power))
        kernel = np.ones(2 * neighbours + 1)
        about = slice(neighbours, neighbours + len(power))
        count = np.convolve(np.ones(len(power)), kernel)[about]
        mean = np.convolve(self._near_mean(power), kernel)[about] / count
        chance = 1 / (count * looks * max(self.near[1] - self.near[0], 1))
        # Shrunk towards the survey's mean as far as speckle explains the difference.
        share = self.uneven / (self.uneven + chance * np.maximum(mean, 0.1) ** 2)
        return np.clip(1 + share * (mean - 1), *STRENGTH_LIMITS)

    def unevenness(self, power: Float[np.ndarray, "pulse cell"], looks: float) -> float:
        """Return the variance of the volume's strength between pulses in excess of speckle."""
        cells = self.near[1] - self.near[0]
        if cells < 2 * SMOOTHED_CELLS:
            return 0.0
        mean = self._near_mean(power)
        chance = float(np.mean(mean**2)) / (looks * cells + 1)
        variance = float(mean.var())
        return variance - chance if variance > LEAST_UNEVEN * chance else 0.0

    def _near_mean(self, power: Float[np.ndarray, "pulse cell"]) -> Float[np.ndarray, " pulse"]:
        near = slice(*self.near)
        ratio = power[:, near] / self.background[near]
        return np.minimum(ratio, MOST_OVER_MEAN * max(1.0, float(np.median(ratio)))).mean(axis=1)


def first_guess(
    power: Float[np.ndarray, "pulse cell"], range_m: Float[np.ndarray, " cell"], first: int, last: int
) -> VolumeClutter | None:
    """Return a volume that falls as r^-2 from the radar; None in clear air.

    Parameters
    ----------
    power:
        Powers of pulses spread over the survey.
    range_m:
        Ranges of the cells.
    first, last:
        Cells that are tested.

    """
    # A volume over part of the survey shows in the strongest pulses only.
    for share in (0.5, 0.8):
        found = _volume_at(share, power, range_m, first, last)
        if found is not None:
            return found
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
        filled = over >= LEAST_OVER_NOISE and strength > 0 and nearest * MOST_UNEVEN > strength
        if filled and 1 / MOST_UNEVEN < ratio < MOST_UNEVEN:
            return VolumeClutter(mean=strength / np.maximum(range_m, range_m[1]) ** 2, noise=noise)
    return None


def measured_mean(
    guess: VolumeClutter,
    power: Float[np.ndarray, "pulse cell"],
    volume_only: Bool[np.ndarray, "pulse cell"],
    range_m: Float[np.ndarray, " cell"],
) -> Float[np.ndarray, " cell"]:
    """Return the volume's mean from the cells that hold only volume; the law fitted to them where these are few."""
    clipped = np.minimum(power, MOST_OVER_MEAN * guess.background) - guess.noise
    count = volume_only.sum(axis=0).astype(float)
    total = np.where(volume_only, clipped, 0.0).sum(axis=0)
    law = _law(guess, total, count, range_m)
    kernel = np.ones(2 * SMOOTHED_CELLS + 1)
    seen = np.convolve(total / law, kernel, "same") + LOOKS_OF_LAW
    return law * np.maximum(seen / (np.convolve(count, kernel, "same") + LOOKS_OF_LAW), LEAST_OF_LAW)


def _law(
    guess: VolumeClutter,
    total: Float[np.ndarray, " cell"],
    count: Float[np.ndarray, " cell"],
    range_m: Float[np.ndarray, " cell"],
) -> Float[np.ndarray, " cell"]:
    """Return k r^-2 exp(-a r) with the most likely k and a, by Fisher scoring of exponential powers."""
    used = count > 0
    k, loss = 0.0, 0.0
    reach = range_m - range_m[used].mean() if used.any() else range_m
    for _ in range(12):
        mean = guess.mean * np.exp(k - loss * reach)
        # Weight of a cell: sensitivity of its mean to the volume's, given the receiver noise.
        share = mean / (mean + guess.noise)
        weight = np.where(used, count * share**2, 0.0)
        excess = np.where(used, total / np.maximum(count, 1.0) / mean - 1, 0.0)
        design = np.column_stack([np.ones(len(reach)), -reach])
        normal = design.T @ (weight[:, None] * design) + np.diag([1e-9, 1e-9])
        step = np.clip(np.linalg.solve(normal, design.T @ (weight * excess)), [-1.0, -0.05], [1.0, 0.05])
        k, loss = float(np.clip(k + step[0], -MOST_NEPERS, MOST_NEPERS)), float(np.clip(loss + step[1], 0, MOST_LOSS))
    return guess.mean * np.exp(k - loss * reach)
