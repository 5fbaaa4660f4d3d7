"""The mean echo of a volume (rain, snowfall, dust), estimated from the survey that it spoils.

Rain has the same mean profile in every pulse, and ground has not. Some pulses spread over the survey tell the
profile: near the radar a volume that fills the beam falls as r^-2, and stands over the receiver's noise in the
median of the pulses. That first guess tells where each pulse's volume ends (`volume_end`); what lies well before
is volume alone, and all pulses together give its mean in every cell, drawn towards the law where few reach.
Nothing is told of the rain rate, and nothing of the ground.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

# Exponential powers have their median at log 2 of their mean.
MEDIAN_OF_MEAN = float(np.log(2))
# Cells next to the radar in which a volume is looked for, and how far it stands there over the noise.
NEAR_CELLS = 24
LEAST_OVER_NOISE = 2.0
# Power times r^2 of the nearer over that of the farther half of these cells is one in a volume.
MOST_UNEVEN = 3.0
# Share of cells with noise alone that is certain to be there.
QUIET_SHARE = 0.05
# Cells over which the estimate is smoothed, each way, and the looks that the law is worth.
SMOOTHED_CELLS = 8
LOOKS_OF_LAW = 200.0
# Of exponential powers one in 3000 exceeds 8 means: what does is no volume.
MOST_OVER_MEAN = 8.0
LEVELS = 10.0 ** (np.arange(-12.0, 49.0, 3.0) / 10)
# Mean and relative spread of the radial fall of drops as millimetre waves weigh them (Lhermitte 1990, "Attenuation
# and scattering of millimeter wavelength radiation by clouds and precipitation": 4 to 5 m/s from 1 to 50 mm/h).
FALL_SPEED_MPS = 4.5
FALL_SPREAD = 0.25


@dataclass(frozen=True, kw_only=True, eq=False)
class VolumeClutter:
    """Mean powers of a volume in the range cells, as far as it reaches in the beam.

    mean: of the volume; noise: of the receiver, one for all cells.
    level, level_share: the ground's strongest mean over the volume's, and in which share of the pulses it is so.
    fall_mps, drift_spread: speed at which what fills the volume falls, and its relative spread.
    """

    mean: Float[np.ndarray, " cell"]
    noise: float
    level: Float[np.ndarray, " level"]
    level_share: Float[np.ndarray, " level"]
    fall_mps: float = FALL_SPEED_MPS
    drift_spread: float = FALL_SPREAD

    @property
    def background(self) -> Float[np.ndarray, " cell"]:
        """Mean power of volume and noise."""
        return self.mean + self.noise

    def clutter_threshold(self, false_alarm_probability: float) -> Float[np.ndarray, " cell"]:
        """Return what volume and noise alone exceed with a probability: a clutter map's threshold."""
        return -np.log(false_alarm_probability) * self.background


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
    level = np.median(power, axis=0) / MEDIAN_OF_MEAN
    noise = float(np.quantile(level[first:last], QUIET_SHARE))
    near = slice(first, min(first + NEAR_CELLS, last))
    over = level[near] / max(noise, np.finfo(float).tiny)
    compensated = (level[near] - noise) * range_m[near] ** 2
    half = len(compensated) // 2
    if half == 0 or np.median(over[:half]) < LEAST_OVER_NOISE or np.median(compensated) <= 0:
        return None
    ratio = np.median(compensated[:half]) / max(np.median(compensated[half:]), np.finfo(float).tiny)
    if not 1 / MOST_UNEVEN < ratio < MOST_UNEVEN:
        return None
    mean = np.median(compensated) / np.maximum(range_m, range_m[1]) ** 2
    even = np.full(len(LEVELS), 1 / len(LEVELS))
    return VolumeClutter(mean=mean, noise=noise, level=LEVELS, level_share=even)


def measured_mean(
    guess: VolumeClutter,
    power: Float[np.ndarray, "pulse cell"],
    volume_alone: Bool[np.ndarray, "pulse cell"],
    range_m: Float[np.ndarray, " cell"],
) -> Float[np.ndarray, " cell"]:
    """Return the volume's mean from the cells that hold it alone; the law fitted to them where few do."""
    clipped = np.minimum(power, MOST_OVER_MEAN * guess.background) - guess.noise
    count = volume_alone.sum(axis=0).astype(float)
    total = np.where(volume_alone, clipped, 0.0).sum(axis=0)
    law = _law(guess, total, count, range_m)
    kernel = np.ones(2 * SMOOTHED_CELLS + 1)
    seen = np.convolve(total / law, kernel, "same") + LOOKS_OF_LAW
    return law * np.maximum(seen / (np.convolve(count, kernel, "same") + LOOKS_OF_LAW), 0.0)


def _law(
    guess: VolumeClutter,
    total: Float[np.ndarray, " cell"],
    count: Float[np.ndarray, " cell"],
    range_m: Float[np.ndarray, " cell"],
) -> Float[np.ndarray, " cell"]:
    """Return k r^-2 exp(-a r) with the most likely k and a, by scoring of exponential powers."""
    used = count > 0
    k, loss = 0.0, 0.0
    reach = range_m - range_m[used].mean() if used.any() else range_m
    for _ in range(12):
        mean = guess.mean * np.exp(k - loss * reach)
        # Weight of a cell: how far its mean tells of the volume's, the noise of the receiver counted.
        share = mean / (mean + guess.noise)
        weight = np.where(used, count * share**2, 0.0)
        excess = np.where(used, total / np.maximum(count, 1.0) / mean - 1, 0.0)
        design = np.column_stack([np.ones(len(reach)), -reach])
        normal = design.T @ (weight[:, None] * design) + np.diag([1e-9, 1e-9])
        step = np.clip(np.linalg.solve(normal, design.T @ (weight * excess)), [-1.0, -0.05], [1.0, 0.05])
        k, loss = k + step[0], max(loss + step[1], 0.0)
    return guess.mean * np.exp(k - loss * reach)
