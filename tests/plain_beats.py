"""Beat signals by the plain sum of the exact phase, sample by sample and path by path."""

import numpy as np

from direct_receiver import C, points_at
from sionna_radar.tracing.paths import Paths

SWEEPS = [(sweep, sampling) for sweep in ("up", "down") for sampling in ("real", "iq")]


def plain_sum(paths: Paths, index: np.ndarray, chirp) -> np.ndarray:
    """The beat by its definition: the sent wave times the conjugate of each received one.

    The phase between them is 2 pi (f0 tau + S t tau - S tau^2 / 2) with tau = 2 (r + v t) / c. A down-sweep is
    mixed the other way round, so that a range reads as a positive frequency again.
    """
    t = (np.arange(chirp.samples) - chirp.samples // 2) / (chirp.samples * chirp.rate_hz)
    sign = 1 if chirp.sweep == "up" else -1
    slope = sign * chirp.bandwidth_hz * chirp.rate_hz
    out = np.zeros((len(index), chirp.samples), dtype=complex)
    for k in range(len(paths)):
        tau = paths.delay_s[k] + 2 * paths.range_rate_mps[k] * t / C
        phase = 2 * np.pi * (chirp.carrier_hz * tau + slope * t * tau - slope * tau**2 / 2)
        between = np.conj(paths.gain[k]) * np.exp(1j * phase)
        out[np.searchsorted(index, paths.pulse[k])] += between if sign > 0 else np.conj(between)
    return out if chirp.sampling == "iq" else np.sqrt(2) * out.real


def mover_beats(chirp, middle_s: np.ndarray, range_m: float, rate_mps: float, power: float = 1.0) -> np.ndarray:
    """Return the beats of a mover in chirps around times, from the phase of its delay at every sample."""
    time_s = chirp.sample_time_s
    delay_s = 2 * (range_m + rate_mps * (middle_s[:, None] + time_s)) / C
    swept = chirp.slope_hz_s * time_s * delay_s - chirp.slope_hz_s * delay_s**2 / 2
    phase = 2 * np.pi * chirp.direction * (chirp.carrier_hz * delay_s + swept)
    return np.sqrt(power) * (np.exp(1j * phase) if chirp.sampling == "iq" else np.sqrt(2) * np.cos(phase))


def relative_error(measured: np.ndarray, expected: np.ndarray) -> float:
    """Largest error of a sample over the root mean square of its pulse."""
    level = np.sqrt(np.mean(np.abs(expected) ** 2, axis=1, keepdims=True))
    return float(np.max(np.abs(measured - expected) / level))


def random_paths(seed: int, count: int, pulses: int, rates: tuple[float, float]) -> Paths:
    random = np.random.default_rng(seed)
    gain = random.normal(size=count) + 1j * random.normal(size=count)
    pulse = np.sort(random.integers(10, 10 + pulses, count))
    return points_at(random.uniform(25, 120, count), 1e-6 * gain, random.uniform(*rates, count), pulse)
