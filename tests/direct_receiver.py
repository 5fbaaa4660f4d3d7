"""A receiver computed by definition: phases of the wave sent and of the wave that comes back, at every instant.

No approximation but that of the range, linear over the sweep. It is the oracle of everything in `sionna_radar.signal`.
"""

from collections.abc import Callable

import numpy as np

from sionna_radar.radar.chirp import Chirp
from sionna_radar.tracing.paths import Paths

C = 299_792_458.0


def still(t: np.ndarray) -> np.ndarray:
    """The phase error of an ideal oscillator."""
    return np.zeros(t.shape)


def direct_beat(
    paths: Paths, chirp: Chirp, time_s: np.ndarray, error_rad: Callable[[np.ndarray], np.ndarray] = still
) -> np.ndarray:
    """Return the complex beat of paths at times from the middle of a sweep, for unit transmitted power.

    The wave sent has the phase 2 pi (f0 t + S t^2 / 2) + error(t); what comes back at t was sent at t - tau(t). A
    down-sweep is mixed the other way round.
    """

    def sent(t: np.ndarray) -> np.ndarray:
        cycles = np.longdouble(chirp.carrier_hz) * t + np.longdouble(chirp.slope_hz_s) * t**2 / 2
        return 2 * np.pi * np.asarray(cycles - np.floor(cycles), dtype=float) + error_rad(np.asarray(t, dtype=float))

    t = np.asarray(time_s, dtype=np.longdouble)
    beat = np.zeros(len(t), dtype=complex)
    for delay, rate, gain in zip(paths.delay_s, paths.range_rate_mps, paths.gain, strict=True):
        mixed = np.conj(gain) * np.exp(1j * (sent(t) - sent(t - delay - 2 * rate * t / C)))
        beat += mixed if chirp.direction > 0 else np.conj(mixed)
    return beat


def points_at(
    range_m: object, gain: object = 1.0, rate_mps: object = 0.0, pulse: object = 0, **columns: np.ndarray
) -> Paths:
    """Return paths of points at ranges, with other columns than those of upright ground where given."""
    far, gains, rates, pulses = np.broadcast_arrays(np.asarray(range_m, dtype=float), gain, rate_mps, pulse)
    far, gains, rates, pulses = (np.atleast_1d(a) for a in (far, gains, rates, pulses))
    count = len(far)
    usual = {
        "pulse": pulses.astype(np.int64),
        "delay_s": 2 * far / C,
        "gain": gains.astype(complex),
        "range_rate_mps": rates.astype(float),
        "incidence_rad": np.zeros(count),
        "hit_m": np.zeros((count, 3)),
        "surface": np.zeros(count, np.int64),
    }
    return Paths(**(usual | columns))
