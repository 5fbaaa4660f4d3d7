"""The mean of a burst's beat signals, aligned to still ground on the beam's axis.

Between chirps the range of a scatterer changes, and its beat turns by 2 pi (f0 + S t) times the change of its delay.
Taking out what still ground on the axis does leaves the echo of the axis whole; one that recedes faster by v is
weakened, over N chirps a time T apart, to

    |sin(pi N f T) / (N sin(pi f T))|^2,   f = 2 v / wavelength,

the sum of a geometric series. Noise is weakened to one N-th.
"""

import numpy as np
from jaxtyping import Float, Inexact
from scipy.constants import speed_of_light

from sionna_radar.radar.chirp import Chirp


def burst_mean(
    beat: Inexact[np.ndarray, "chirp sample"],
    chirp: Chirp,
    offset_s: Float[np.ndarray, " own"],
    range_rate_mps: Float[np.ndarray, " pulse"],
) -> Inexact[np.ndarray, "pulse sample"]:
    """Return the aligned mean of each burst; an echo that recedes as given keeps its power.

    Parameters
    ----------
    beat:
        Of the chirps, burst by burst.
    chirp:
        The sweep.
    offset_s:
        Time of each chirp of a burst from its middle.
    range_rate_mps:
        Of the ground in each burst, positive when receding.

    """
    delay_s = 2 * range_rate_mps[:, None] * offset_s / speed_of_light
    frequency_hz = chirp.carrier_hz + chirp.slope_hz_s * chirp.sample_time_s
    turns = chirp.direction * delay_s[:, :, None] * frequency_hz
    shape = (len(range_rate_mps), len(offset_s), beat.shape[1])
    mean = np.mean(_analytic(beat, chirp).reshape(shape) * np.exp(-2j * np.pi * np.mod(turns, 1.0)), axis=1)
    return mean if chirp.sampling == "iq" else mean.real


def _analytic(beat: Inexact[np.ndarray, "chirp sample"], chirp: Chirp) -> Inexact[np.ndarray, "chirp sample"]:
    """Return beat signals that can be turned: a real one as the real part of its analytic signal."""
    if chirp.sampling == "iq":
        return beat
    # `scipy.signal` takes as long to import as many a survey to simulate.
    from scipy.signal import hilbert

    analytic: Inexact[np.ndarray, "chirp sample"] = hilbert(beat, axis=1)
    return analytic
