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

The stage of all filters also samples their output. Echoes are filtered over the whole grid: the sweep begins before the
first sample, so that filters have settled. Noise is stationary, and is treated as periodic over the samples.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from jaxtyping import Bool, Complex, Float, Inexact

from sionna_radar.foundation.threads import cores
from sionna_radar.radar.chirp import Chirp
from sionna_radar.signal.beat import beat_phase
from sionna_radar.signal.stages import Received
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


@dataclass(frozen=True, kw_only=True)
class Filters:
    """The filters of a receiver; the default anti-alias filter is ideal and passes only the sampled band.

    high_pass, anti_alias: None for none.
    """

    high_pass: HighPass | None = None
    anti_alias: AntiAlias | None = None

    def __call__(self, received: Received) -> Received:
        """Return the samples, with the noise in them."""
        grid, echoes = received.grid, received.signal
        if grid.oversampling > 1 or self.high_pass is not None or self.anti_alias is not None:
            echoes = self._passed(echoes * grid.taper, grid.chirp, grid.oversampling)
        samples = grid.sampled(echoes)
        if received.noise is None:
            return replace(received, samples=samples)
        noise = self._noise(received.noise, grid.chirp, received.noise_points)
        return replace(received, samples=samples + noise, noise=None)

    def _noise(
        self, noise: Inexact[np.ndarray, "pulse point"], chirp: Chirp, points: int
    ) -> Inexact[np.ndarray, "pulse sample"]:
        if self.anti_alias is not None:
            return self._passed(noise, chirp, points)[:, ::points]
        return noise if self.high_pass is None else self.high_pass.shaped(noise, chirp.sampling_rate_hz)

    def _passed(
        self, signal: Inexact[np.ndarray, "pulse point"], chirp: Chirp, oversampling: int
    ) -> Inexact[np.ndarray, "pulse point"]:
        """Return a filtered signal of `oversampling` points per sample; it is treated as periodic."""
        points, band_hz = signal.shape[1], chirp.sampling_rate_hz
        rate_hz = band_hz * oversampling
        if np.iscomplexobj(signal):
            frequency = scipy.fft.fftfreq(points, 1 / rate_hz)
            # Beats of I/Q samples run from zero to the sampling rate; a finer grid's band has the same middle.
            frequency = np.mod(frequency - band_hz / 2 + rate_hz / 2, rate_hz) + band_hz / 2 - rate_hz / 2
            response = self._response(frequency, (frequency >= 0) & (frequency < band_hz))
            return scipy.fft.ifft(scipy.fft.fft(signal, workers=cores()) * response, workers=cores())
        frequency = scipy.fft.rfftfreq(points, 1 / rate_hz)
        response = self._response(frequency, frequency <= band_hz / 2)
        return scipy.fft.irfft(scipy.fft.rfft(signal, workers=cores()) * response, points, workers=cores())

    def _response(self, beat_hz: Float[np.ndarray, " f"], sampled: Bool[np.ndarray, " f"]) -> Complex[np.ndarray, " f"]:
        response = sampled.astype(np.complex128) if self.anti_alias is None else self.anti_alias.response(beat_hz)
        return response if self.high_pass is None else response * self.high_pass.response(beat_hz)


@dataclass(frozen=True, kw_only=True)
class SampledNoise:
    """Spectrum of the noise in samples, over that of the thermal noise in front of the filters, which is white.

    points: of the noise in front of an anti-alias filter, for each sample.
    rounding: power of the converter's rounding, white behind the filters, over that of the thermal noise.
    """

    filters: Filters
    chirp: Chirp
    points: int
    rounding: float

    def density(self, beat_hz: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the density at frequencies, which repeats with the sampling rate; what folds onto them included."""
        rate_hz, anti_alias, high_pass = self.chirp.sampling_rate_hz, self.filters.anti_alias, self.filters.high_pass
        points = 1 if anti_alias is None else self.points
        # Beats of I/Q samples run from zero to the sampling rate.
        low_hz = (rate_hz if self.chirp.sampling == "iq" else 0.0) / 2 - points * rate_hz / 2
        density = np.full(len(beat_hz), self.rounding)
        for turn in range(points):
            folded_hz = np.mod(beat_hz + turn * rate_hz - low_hz, points * rate_hz) + low_hz
            passed = np.ones(len(beat_hz)) if high_pass is None else high_pass.power_response(folded_hz)
            density += passed if anti_alias is None else passed * np.abs(anti_alias.response(folded_hz)) ** 2
        return density
