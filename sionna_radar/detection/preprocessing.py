"""Preprocessing of beat signals: zeroing of interference bursts, and averaging of the chirps of a burst.

The beat of ground is the sum of many echoes and noise: its samples are Gaussian, of a width that the median estimates
even when a part of them is contaminated. Samples that hardly any Gaussian one would exceed belong to a burst. They are
set to zero (zeroing: Fischer 2016, "Untersuchungen zum Interferenzverhalten automobiler Radarsensorik"), and the rest
is scaled up by the lost share, so that echoes keep their power.

Between chirps the range of a scatterer changes, and its beat turns by 2 pi (f0 + S t) times the change of its delay.
Compensating the turn of stationary ground on the axis preserves the echo of the axis; one that recedes faster by v is
weakened, over N chirps a time T apart, to

    |sin(pi N f T) / (N sin(pi f T))|^2,   f = 2 v / wavelength,

the sum of a geometric series. Noise is weakened to one N-th.
"""

import numpy as np
from jaxtyping import Bool, Float, Inexact
from scipy.constants import speed_of_light

from sionna_radar.radar.chirp import Chirp

# Share of the samples of a pure Gaussian signal that are classified as bursts.
FALSE_BURSTS = 1e-6
# Samples blanked on either side of a detected one: a burst continues below the threshold.
BESIDE = 2


def zeroed(beat: Inexact[np.ndarray, "pulse sample"]) -> Inexact[np.ndarray, "pulse sample"]:
    """Return beat signals without bursts; a signal that is mostly burst is left unchanged."""
    burst = bursts(beat)
    kept_share = 1 - burst.mean(axis=1, keepdims=True)
    burst &= kept_share > 0.5
    return np.where(burst, 0, beat) / np.where(kept_share > 0.5, kept_share, 1.0)


def bursts(beat: Inexact[np.ndarray, "pulse sample"]) -> Bool[np.ndarray, "pulse sample"]:
    """Return the mask of samples in interference bursts."""
    # The median magnitude of a real unit Gaussian is 0.674, and one in a million exceeds 4.89; for a complex one, whose
    # power is exponential, they are sqrt(ln 2) and sqrt(-ln p) in units of the root mean square.
    ratio = np.sqrt(-np.log(FALSE_BURSTS) / np.log(2)) if np.iscomplexobj(beat) else 4.8916 / 0.67449
    size = np.abs(beat)
    width = np.median(size, axis=1, keepdims=True)
    # With a converter so coarse that half of the samples are zero, the width is unknown.
    exceeds = (size > ratio * width) & (width > 0)
    mask = exceeds.copy()
    for step in range(1, BESIDE + 1):
        mask[:, step:] |= exceeds[:, :-step]
        mask[:, :-step] |= exceeds[:, step:]
    return mask


def burst_mean(
    beat: Inexact[np.ndarray, "chirp sample"],
    chirp: Chirp,
    offset_s: Float[np.ndarray, " own"],
    range_rate_mps: Float[np.ndarray, " pulse"],
) -> Inexact[np.ndarray, "pulse sample"]:
    """Return the aligned mean of each burst; an echo of the given range rate keeps its power.

    beat: beat signals of the chirps, burst by burst.
    chirp: the sweep.
    offset_s: time of each chirp of a burst from its middle.
    range_rate_mps: range rate of the ground in each burst, positive when receding.
    """
    delay_s = 2 * range_rate_mps[:, None] * offset_s / speed_of_light
    frequency_hz = chirp.carrier_hz + chirp.slope_hz_s * chirp.sample_time_s
    turns = chirp.direction * delay_s[:, :, None] * frequency_hz
    shape = (len(range_rate_mps), len(offset_s), beat.shape[1])
    mean = np.mean(_analytic(beat, chirp).reshape(shape) * np.exp(-2j * np.pi * np.mod(turns, 1.0)), axis=1)
    return mean if chirp.sampling == "iq" else mean.real


def _analytic(beat: Inexact[np.ndarray, "chirp sample"], chirp: Chirp) -> Inexact[np.ndarray, "chirp sample"]:
    """Return complex beat signals: the analytic signal of real ones."""
    if chirp.sampling == "iq":
        return beat
    # SciPy's signal package is slow to import.
    from scipy.signal import hilbert

    return hilbert(beat, axis=1)
