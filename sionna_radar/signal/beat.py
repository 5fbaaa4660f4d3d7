"""Synthesis of beat signals: a non-uniform Fourier sum over the paths of each chirp.

With the delay tau(t) = 2 r(t) / c of a scatterer, linear over the chirp, the phase between the transmitted and the
received wave is (t from the middle of the sweep, S its slope)

    phi(t) / 2 pi = f0 tau(t) + S t tau(t) - S tau(t)^2 / 2 = c0 + c1 t + c2 t^2

c1 is the beat frequency of Rouveure et al. 2017, eq. 2, with its small cross terms, and c2 the drift of the
beat while the scatterer moves. The paths of a chirp have nearly the same c2: their power-weighted mean is applied
exactly, and the differences from it as a power series, as far as they matter.
"""

import math
from dataclasses import dataclass

import finufft
import numpy as np
from jaxtyping import Bool, Complex, Float, Inexact
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.chirp import Chirp
from sionna_radar.tracing.paths import Paths

NUFFT_ACCURACY = 1e-9
DRIFT_ACCURACY = 1e-3


@dataclass(frozen=True)
class PhasePolynomial:
    """Beat phase of each path in cycles: constant, per second, per second squared."""

    constant: Float[np.ndarray, " path"]
    frequency_hz: Float[np.ndarray, " path"]
    drift_hz_s: Float[np.ndarray, " path"]


def phase_polynomial(
    delay_s: Float[np.ndarray, " path"], range_rate_mps: Float[np.ndarray, " path"], chirp: Chirp
) -> PhasePolynomial:
    """Return the beat phase of paths; a down-sweep is mixed so that ranges stay positive."""
    f0, slope, sign = chirp.carrier_hz, chirp.slope_hz_s, chirp.direction
    stretch = 2 * np.asarray(range_rate_mps, dtype=np.float64) / speed_of_light
    return PhasePolynomial(
        constant=sign * (f0 * delay_s - slope * delay_s**2 / 2),
        frequency_hz=sign * (f0 * stretch + slope * delay_s - slope * delay_s * stretch),
        drift_hz_s=sign * (slope * stretch - slope * stretch**2 / 2),
    )


def beat_phase(paths: Paths, chirp: Chirp) -> PhasePolynomial:
    """Return the beat phase of paths in one sweep of their pulse; their delays refer to the whole pulse."""
    delay_s = paths.delay_s
    if chirp.centre_s:
        delay_s = delay_s + chirp.centre_s * 2 * paths.range_rate_mps.astype(np.float64) / speed_of_light
    return phase_polynomial(delay_s, paths.range_rate_mps, chirp)


def synthesise(paths: Paths, pulses: Pulses, chirp: Chirp) -> Inexact[np.ndarray, "pulse sample"]:
    """Return the noise-free beat signals of a block of pulses for unit transmitted power.

    A path of gain a adds the power |a|^2: a complex exponential of magnitude |a| in I/Q samples, a
    cosine of amplitude sqrt(2) |a| in real ones. An ideal filter removes beats outside the unambiguous band.

    Parameters
    ----------
    paths:
        Paths of the block, sorted by pulse.
    pulses:
        The pulses of the block.
    chirp:
        The sweep.

    """
    phase = beat_phase(paths, chirp)
    gain = np.conj(paths.gain) if chirp.direction > 0 else paths.gain
    rotor = np.exp(2j * np.pi * np.mod(phase.constant, 1.0))
    # A plain call, not an expression: NumPy may swap the factors of a large temporary, and a fused complex
    # product then rounds differently from block size to block size.
    weight = np.multiply(gain, rotor)
    weight[~_passed(phase.frequency_hz, chirp)] = 0.0
    turn = 2 * np.pi * phase.frequency_hz / chirp.sampling_rate_hz
    first = np.searchsorted(paths.pulse, pulses.index, side="left")
    last = np.searchsorted(paths.pulse, pulses.index, side="right")
    beat = np.zeros((len(pulses), chirp.samples), dtype=np.complex128)
    # The points of a beam are in no useful order, so they are not sorted; the smaller grid suits few points per chirp.
    plan = finufft.Plan(1, (chirp.samples,), eps=NUFFT_ACCURACY, isign=1, nthreads=1, spread_sort=0, upsampfac=1.25)
    for row, (start, stop) in enumerate(zip(first, last, strict=True)):
        if start < stop:
            part = slice(start, stop)
            beat[row] = _one_chirp(plan, turn[part], weight[part], phase.drift_hz_s[part], chirp)
    return beat if chirp.sampling == "iq" else np.sqrt(2) * beat.real


def _one_chirp(
    plan: finufft.Plan,
    turn: Float[np.ndarray, " path"],
    weight: Complex[np.ndarray, " path"],
    drift_hz_s: Float[np.ndarray, " path"],
    chirp: Chirp,
) -> Complex[np.ndarray, " sample"]:
    time_s = chirp.sample_time_s
    power = weight.real**2 + weight.imag**2
    total = power.sum()
    if total == 0.0:
        return np.zeros(len(time_s), dtype=np.complex128)
    mean_drift = float(power @ drift_hz_s / total)
    # Phase added by each path's individual drift at the ends of the sweep.
    excess = 2 * np.pi * (drift_hz_s - mean_drift) * (chirp.duration_s / 2) ** 2
    plan.setpts(turn)
    beat = plan.execute(weight)
    term, order = weight * (1j * excess), 1
    # The root mean square of (2 t / T)^(2 n) over the sweep is 1 / sqrt(4 n + 1).
    while np.linalg.norm(term) > DRIFT_ACCURACY * math.sqrt((4 * order + 1) * total):
        beat += plan.execute(term) * (2 * time_s / chirp.duration_s) ** (2 * order)
        order += 1
        term = term * (1j * excess / order)
    return beat * np.exp(2j * np.pi * mean_drift * time_s**2)


def _passed(frequency_hz: Float[np.ndarray, " path"], chirp: Chirp) -> Bool[np.ndarray, " path"]:
    """Return which beats lie inside the sampled band."""
    half = chirp.sampling_rate_hz / 2
    # Complex samples cover 0 to the sampling rate; a real signal folds negative frequencies onto positive.
    centre = half if chirp.sampling == "iq" else 0.0
    return np.abs(frequency_hz - centre) < half
