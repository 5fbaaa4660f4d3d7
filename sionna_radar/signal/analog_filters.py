"""Filters before the converter: anti-alias low-pass, high-pass, and a gain over range.

High-pass and gain over range act at the intermediate frequency, between mixer and ADC. The beat of a near echo is low
and strong, that of far ground high and weak. A high-pass attenuates near echoes before sampling: with its corner beyond
the ranges of interest, order n weights powers by r^2n, so that order 1 compensates the r^-2 of a beam-filling volume,
and order 2 the r^-4 of points. The benefit is dynamic range of the ADC and less transmitter leakage; calibrated spectra
are the same with and without it.

A gain over range acts only between two frequencies: zeros at the lower one and poles at the upper one, for each
order ((jf + f1) / (jf + f2)), so that the attenuation of the nearest ranges is limited to the ratio of both.

Each path's beat is a steady tone, which the filter multiplies by its complex response at that frequency; a chirp
is much longer than the filter's settling time. Thermal noise enters before the filter and is shaped like the echoes, so
its level in a calibrated spectrum is the same at all ranges.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Inexact

from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.receiver import ReceiverTable
from sionna_radar.signal.beat import beat_phase
from sionna_radar.tracing.paths import Paths


@dataclass(frozen=True, kw_only=True)
class AntiAlias:
    """A Butterworth low-pass: power response 1 / (1 + (f / corner)^(2 order)).

    With I/Q samples, whose band is zero to the sampling rate, f counts from the middle of that band.
    """

    corner_hz: float
    order: int
    chirp: Chirp

    def response(self, beat_hz: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " n"]:
        """Return the complex response at beats, negative ones too; time as exp(+j w t)."""
        # SciPy's signal package is slow to import.
        import scipy.signal

        middle_hz = self.chirp.sampling_rate_hz / 2 if self.chirp.sampling == "iq" else 0.0
        poles = scipy.signal.butter(self.order, 2 * np.pi * self.corner_hz, analog=True, output="zpk")
        response: Complex[np.ndarray, " n"]
        _, response = scipy.signal.freqs_zpk(*poles, 2 * np.pi * (beat_hz - middle_hz))
        return response

    @property
    def slowest_rad_s(self) -> float:
        """Rate at which the slowest part of what it has heard dies away."""
        # The slowest pole of a Butterworth filter lies at sin(pi / 2 order) of its corner from the axis.
        return float(2 * np.pi * self.corner_hz * np.sin(np.pi / (2 * self.order)))

    def left(self, oversampling: int) -> float:
        """Return the power response at the edge of a band `oversampling` times as wide as that of the samples."""
        edge_hz = oversampling * self.chirp.sampling_rate_hz / 2
        return float(1 / (1 + (edge_hz / self.corner_hz) ** (2 * self.order)))


def build_anti_alias(table: ReceiverTable, chirp: Chirp) -> AntiAlias | None:
    """Return the anti-alias filter of a scenario; None where it is ideal."""
    if table.anti_alias_corner_hz == 0:
        return None
    return AntiAlias(corner_hz=table.anti_alias_corner_hz, order=table.anti_alias_order, chirp=chirp)


@dataclass(frozen=True, kw_only=True)
class RangeGain:
    """A gain that rises to one by 6 dB per octave and order between two frequencies."""

    from_hz: float
    to_hz: float
    order: int

    def response(self, frequency_hz: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " n"]:
        """Return the complex response at frequencies, negative ones too; time as exp(+j w t)."""
        gain: Complex[np.ndarray, " n"] = (1j * frequency_hz + self.from_hz) / (1j * frequency_hz + self.to_hz)
        return gain**self.order

    def power_response(self, frequency_hz: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the ratio of the powers after and before it."""
        squared = np.square(frequency_hz)
        gain: Float[np.ndarray, " n"] = (squared + self.from_hz**2) / (squared + self.to_hz**2)
        return gain**self.order


@dataclass(frozen=True, kw_only=True)
class HighPass:
    """A Butterworth high-pass, power response 1 / (1 + (corner / f)^(2 order)), and a gain over range behind it.

    corner_hz: 0 for no high-pass. range_gain: None for an even one.
    """

    corner_hz: float
    order: int
    range_gain: RangeGain | None = None

    @property
    def slowest_rad_s(self) -> float:
        """Rate at which the slowest part of what it has heard dies away."""
        # The slowest pole of a Butterworth filter lies at sin(pi / 2 order) of its corner from the axis.
        rates = [2 * np.pi * self.corner_hz * np.sin(np.pi / (2 * self.order))] if self.corner_hz else []
        return float(min(rates + ([2 * np.pi * self.range_gain.to_hz] if self.range_gain is not None else [])))

    def response(self, frequency_hz: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " n"]:
        """Return the complex response at frequencies, negative ones too; time as exp(+j w t)."""
        if self.range_gain is None:
            return self._high_passed(frequency_hz)
        gain = self.range_gain.response(frequency_hz)
        return gain * self._high_passed(frequency_hz) if self.corner_hz else gain

    def _high_passed(self, frequency_hz: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " n"]:
        # SciPy's signal package is slow to import.
        import scipy.signal

        zeros, poles, gain = scipy.signal.butter(
            self.order, 2 * np.pi * self.corner_hz, btype="highpass", analog=True, output="zpk"
        )
        response: Complex[np.ndarray, " n"]
        _, response = scipy.signal.freqs_zpk(zeros, poles, gain, 2 * np.pi * frequency_hz)
        return response

    def power_response(self, frequency_hz: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the ratio of the powers after and before the filter."""
        gain = np.ones_like(frequency_hz) if self.range_gain is None else self.range_gain.power_response(frequency_hz)
        if self.corner_hz == 0:
            return gain
        raised: Float[np.ndarray, " n"] = np.abs(frequency_hz / self.corner_hz) ** (2 * self.order)
        return raised / (1 + raised) * gain

    def filtered(self, paths: Paths, chirp: Chirp) -> Paths:
        """Return paths with the gains of their beats after the filter."""
        response = self.response(beat_phase(paths, chirp).frequency_hz)
        # An up-sweep's beat has the conjugate of a path's gain.
        return replace(paths, gain=paths.gain * (np.conj(response) if chirp.direction > 0 else response))

    def shaped(
        self, noise: Inexact[np.ndarray, "pulse sample"], sampling_rate_hz: float
    ) -> Inexact[np.ndarray, "pulse sample"]:
        """Return noise after the filter; being stationary, it is treated as periodic over the chirp."""
        samples = noise.shape[1]
        if np.iscomplexobj(noise):
            # I/Q samples represent beats from zero to the sampling rate.
            response = self.response(np.arange(samples) * (sampling_rate_hz / samples))
            return scipy.fft.ifft(scipy.fft.fft(noise) * response)
        response = self.response(scipy.fft.rfftfreq(samples, 1 / sampling_rate_hz))
        return scipy.fft.irfft(scipy.fft.rfft(noise) * response, samples)


def build_high_pass(table: ReceiverTable) -> HighPass | None:
    """Return the high-pass of a scenario, with its gain over range; None if it has none."""
    rising = table.range_gain
    if table.high_pass_corner_hz == 0 and rising is None:
        return None
    gain = None if rising is None else RangeGain(from_hz=rising.from_hz, to_hz=rising.to_hz, order=rising.order)
    return HighPass(corner_hz=table.high_pass_corner_hz, order=table.high_pass_order, range_gain=gain)
