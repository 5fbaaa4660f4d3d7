"""The filters between mixer and converter, and the sampling of what passes them.

Echoes are filtered over the whole grid: the sweep goes on before the first sample, so that filters have settled. Noise
is stationary, and is treated as periodic over the samples.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Inexact

from sionna_radar.foundation.threads import cores
from sionna_radar.scenario.bases import StageParameters
from sionna_radar.signal.high_pass import HighPass
from sionna_radar.signal.stages import Received, StageInputs, register_receiver_stage


@dataclass(frozen=True, kw_only=True)
class Filters:
    """The filters of a receiver; without an anti-alias filter an ideal one lets pass the sampled band alone.

    high_pass: None for none.
    """

    high_pass: HighPass | None = None

    def __call__(self, received: Received) -> Received:
        """Return the samples, with the noise in them."""
        grid, echoes = received.grid, received.signal
        if grid.oversampling > 1 or self.high_pass is not None:
            echoes = self._passed(echoes * grid.taper, grid.wide.sampling_rate_hz, grid.oversampling)
        samples = grid.sampled(echoes)
        noise = received.noise
        if noise is not None and self.high_pass is not None:
            noise = self.high_pass.shaped(noise, grid.chirp.sampling_rate_hz)
        return replace(received, samples=samples if noise is None else samples + noise, noise=None)

    def _passed(
        self, signal: Inexact[np.ndarray, "pulse point"], rate_hz: float, oversampling: int
    ) -> Inexact[np.ndarray, "pulse point"]:
        points = signal.shape[1]
        band_hz = rate_hz / oversampling
        if np.iscomplexobj(signal):
            # Beats of I/Q samples run from zero to the sampling rate; a finer grid knows negative ones as such.
            finer = scipy.fft.fftfreq(points, 1 / rate_hz)
            frequency = finer if oversampling > 1 else np.mod(finer, rate_hz)
            response = self._response(frequency) * ((frequency >= 0) & (frequency < band_hz))
            return scipy.fft.ifft(scipy.fft.fft(signal, workers=cores()) * response, workers=cores())
        frequency = scipy.fft.rfftfreq(points, 1 / rate_hz)
        response = self._response(frequency) * (frequency <= band_hz / 2)
        return scipy.fft.irfft(scipy.fft.rfft(signal, workers=cores()) * response, points, workers=cores())

    def _response(self, frequency_hz: Float[np.ndarray, " f"]) -> Complex[np.ndarray, " f"]:
        if self.high_pass is None:
            return np.ones(len(frequency_hz), dtype=np.complex128)
        return self.high_pass.response(frequency_hz)


@register_receiver_stage("filters", StageParameters)
def build_filters(_: StageParameters, given: StageInputs) -> Filters:
    """Return the filters of a scenario's receiver."""
    return Filters(high_pass=given.high_pass)
