"""The filters between mixer and converter, and the sampling of their output.

Echoes are filtered over the whole grid: the sweep begins before the first sample, so that filters have settled. Noise
is stationary, and is treated as periodic over the samples.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from jaxtyping import Bool, Complex, Float, Inexact

from sionna_radar.foundation.threads import cores
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.bases import StageParameters
from sionna_radar.signal.analog_filters import AntiAlias, HighPass
from sionna_radar.signal.stages import Received, StageInputs


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


def build_filters(_: StageParameters, given: StageInputs) -> Filters:
    """Return the filters of a scenario's receiver."""
    return Filters(high_pass=given.high_pass, anti_alias=given.anti_alias)
