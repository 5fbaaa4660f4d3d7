"""Oscillator errors: phase noise and frequency errors of the sweep.

An echo of delay tau is mixed with the transmitted wave, so that the phase error e(t) of the oscillator enters
its beat as e(t) - e(t - tau). A random error of spectrum S(f) becomes 4 sin^2(pi f tau) S(f): near echoes are
cleaner than far ones (Budge and Burt 1993, "Range correlation effects on phase and amplitude noise", Southeastcon).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Int

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import read_numbers, shown
from sionna_radar.foundation.randomness import Stream, pulse_generators
from sionna_radar.radar.chirp import Chirp

COLUMNS = {"time_s": None, "error_hz": None}
# Number of frequencies over which a spectrum is summed.
FREQUENCIES = 512
# Upper limit of the extrapolation of steep tables below their first offset.
MAX_DBC_HZ = 300.0


@dataclass(frozen=True, kw_only=True)
class SweepError:
    """Frequency error over a sweep, held constant before and after it.

    duration_s: of the whole sweep.
    quadratic_hz, cubic_hz: errors at the ends of the sweep.
    sinusoidal_hz, sinusoidal_periods: amplitude of a sinusoidal error, and its periods in the sweep.
    settling_hz, settling_time_s: error at its start, and the time constant of its decay; None for none.
    middle_s: origin of time, after the middle of the whole sweep.
    points: times after its start and additional errors in Hz, interpolated linearly.
    """

    duration_s: float
    quadratic_hz: float = 0.0
    cubic_hz: float = 0.0
    sinusoidal_hz: float = 0.0
    sinusoidal_periods: float = 1.0
    settling_hz: float = 0.0
    settling_time_s: float | None = None
    middle_s: float = 0.0
    points: Float[np.ndarray, "2 point"] | None = None

    def frequency_hz(self, time_s: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
        """Return the frequency error at given times."""
        whole = self.duration_s
        t = self._inside(time_s)
        error = self.quadratic_hz * (2 * t / whole) ** 2 + self.cubic_hz * (2 * t / whole) ** 3
        error += self.sinusoidal_hz * np.sin(2 * np.pi * self.sinusoidal_periods * t / whole)
        if self.settling_time_s is not None:
            error += self.settling_hz * np.exp(-(t + whole / 2) / self.settling_time_s)
        if self.points is not None:
            error += np.interp(t + whole / 2, *self.points)
        return error

    def phase(self, time_s: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
        """Return the phase error at times, rad: its integral, but for a constant."""
        whole = self.duration_s
        t = self._inside(time_s)
        turns = self.quadratic_hz * 4 * t**3 / (3 * whole**2) + self.cubic_hz * 2 * t**4 / whole**3
        period = whole / self.sinusoidal_periods
        turns -= self.sinusoidal_hz * period / (2 * np.pi) * np.cos(2 * np.pi * t / period)
        if self.settling_time_s is not None:
            decay = self.settling_time_s
            turns -= self.settling_hz * decay * np.exp(-(t + whole / 2) / decay)
        if self.points is not None:
            turns += self._summed(t + whole / 2)
        return 2 * np.pi * (turns + self.frequency_hz(time_s) * (time_s + self.middle_s - t))

    def _inside(self, time_s: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
        return np.clip(time_s + self.middle_s, -self.duration_s / 2, self.duration_s / 2)

    def _summed(self, after_s: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
        """Return the integral of the points' error from the first point on."""
        assert self.points is not None
        time, error = self.points
        clipped_s = np.clip(after_s, time[0], time[-1])
        integral = np.concatenate([[0.0], np.cumsum(np.diff(time) * (error[1:] + error[:-1]) / 2)])
        before = np.minimum(np.searchsorted(time, clipped_s, side="right") - 1, len(time) - 2)
        since_s = clipped_s - time[before]
        slope = (error[before + 1] - error[before]) / (time[before + 1] - time[before])
        sums: Float[np.ndarray, " t"] = integral[before] + since_s * (error[before] + slope * since_s / 2)
        return sums + (after_s - clipped_s) * np.where(after_s < time[0], error[0], error[-1])


@dataclass(frozen=True)
class PhaseNoise:
    """Stationary Gaussian phase noise by its single-sideband levels at offsets from the carrier.

    levels_dbc_hz: offsets in Hz, and levels in dBc/Hz.
    """

    levels_dbc_hz: tuple[tuple[float, float], ...]

    def density(self, offset_hz: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
        """Return the single-sideband level over the carrier, 1/Hz; zero at zero offset.

        It is the two-sided power density of the phase, in rad^2/Hz; the one-sided density is twice as large.
        """
        log_table, level = (
            np.log10([f for f, _ in self.levels_dbc_hz]),
            np.array([dbc for _, dbc in self.levels_dbc_hz]),
        )
        log_offset = np.log10(np.where(offset_hz > 0, offset_hz, 1.0))
        level_dbc = np.interp(log_offset, log_table, level)
        if len(log_table) > 1:
            slope = (level[1] - level[0]) / (log_table[1] - log_table[0])
            level_dbc += np.where(log_offset < log_table[0], slope * (log_offset - log_table[0]), 0.0)
        return np.where(offset_hz > 0, 10.0 ** (np.minimum(level_dbc, MAX_DBC_HZ) / 10), 0.0)

    def waves(
        self, seed: int, pulse: Int[np.ndarray, " pulse"], points: int, rate_hz: float, sweep: int = 0
    ) -> "PhaseWaves":
        """Return the random phases of sweeps of pulses: `points` at a rate, taken from a period twice as long."""
        period = scipy.fft.next_fast_len(2 * points, real=True)
        period += period % 2
        offset_hz = scipy.fft.rfftfreq(period, 1 / rate_hz)
        sigma = np.sqrt(self.density(offset_hz) * (rate_hz / period) / 2)
        sigma[-1] = 0.0  # half the rate has no phase of its own
        amplitude = np.empty((len(pulse), len(offset_hz)), dtype=np.complex128)
        for row, generator in enumerate(pulse_generators(seed, Stream.PHASE_NOISE, pulse)):
            normal = generator.standard_normal((sweep + 1, 2, len(offset_hz)))[sweep]
            amplitude[row] = sigma * (normal[0] + 1j * normal[1])
        return PhaseWaves(offset_hz, amplitude, points)


@dataclass(frozen=True)
class PhaseWaves:
    """Phases as sums of waves of both signs of frequency."""

    offset_hz: Float[np.ndarray, " wave"]
    amplitude: Complex[np.ndarray, "pulse wave"]
    points: int

    def difference(self, delay_s: float, rows: Int[np.ndarray, " row"]) -> Float[np.ndarray, "row point"]:
        """Return the phase differences over a delay in some pulses, rad, exact for any delay."""
        response = -np.expm1(-2j * np.pi * self.offset_hz * delay_s)
        length = 2 * (len(self.offset_hz) - 1)
        phase: Float[np.ndarray, "row point"] = scipy.fft.irfft(self.amplitude[rows] * response, length, norm="forward")
        return phase[:, : self.points]


@dataclass(frozen=True, kw_only=True)
class Oscillator:
    """A real oscillator.

    error: of each sweep of a pulse; None for linear sweeps. noise: None for none.
    scale: of all ranges and range rates, by the drift of the reference.
    """

    error: SweepError | None = None
    noise: PhaseNoise | None = None
    scale: float = 1.0

    @property
    def ideal(self) -> bool:
        """Whether the sweep is linear and free of phase noise."""
        return self.error is None and self.noise is None

    def shift_hz(self, chirp: Chirp) -> float:
        """Return a bound on the frequency deviation from the ideal sweep: largest error plus four sigma of noise."""
        bend = 0.0 if self.error is None else float(np.max(np.abs(self.error.frequency_hz(chirp.sample_time_s))))
        if self.noise is None:
            return bend
        half_hz = chirp.sampling_rate_hz / 2
        offset_hz = np.linspace(0.0, half_hz, FREQUENCIES + 1)[1:]
        random = np.sqrt(2 * np.sum(offset_hz**2 * self.noise.density(offset_hz)) * half_hz / FREQUENCIES)
        return bend + 4 * float(random)

    def fastest_hz(self, chirp: Chirp) -> float:
        """Return the highest frequency of the beat's phase error as a function of the echo's delay."""
        return self.shift_hz(chirp) + (0.0 if self.noise is None else chirp.sampling_rate_hz / 2)


def read_sweep_error(path: Path) -> Float[np.ndarray, "2 point"]:
    """Return the times (s) and errors (Hz) of a table of a sweep; InputFileError where it cannot be used."""
    name = "radar.receiver.oscillator.sweep_error"
    points = np.array(read_numbers(path, name, COLUMNS, f"give a CSV of {','.join(COLUMNS)}", further="ignored")[1])
    if points.shape[1] < 2 or np.any(np.diff(points[0]) <= 0):
        raise InputFileError(f"{name} {shown(path)}: time_s must increase from row to row, in two rows or more")
    return points
