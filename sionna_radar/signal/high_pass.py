"""A high-pass at the intermediate frequency, between mixer and sampler.

The beat of a near echo is low and strong, that of far ground high and weak. A high-pass takes the near ones down before
they are sampled: with its corner beyond the ranges of interest, an order n weighs powers by r^2n, so that order 1
makes up for the r^-2 of a volume that fills the beam, and order 2 for r^-4 of points. What it buys is dynamic range
of the converter and less of the transmitter's leakage; calibrated spectra are the same with and without.

Each path's beat is a steady tone, which the filter turns and weakens by its response at the tone's frequency; a chirp
is long against the filter's settling. Thermal noise enters before the filter and is shaped like the echoes, so that
its level in a calibrated spectrum stays one number for all ranges.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
import scipy.signal
from jaxtyping import Complex, Float, Inexact

from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.radar import ReceiverTable
from sionna_radar.signal.beat import beat_phase
from sionna_radar.tracing.paths import Paths


@dataclass(frozen=True, kw_only=True)
class HighPass:
    """A Butterworth high-pass: power response 1 / (1 + (corner / f)^(2 order))."""

    corner_hz: float
    order: int

    def response(self, frequency_hz: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " n"]:
        """Return the complex response at frequencies, negative ones too; time as exp(+j w t)."""
        zeros, poles, gain = scipy.signal.butter(
            self.order, 2 * np.pi * self.corner_hz, btype="highpass", analog=True, output="zpk"
        )
        response: Complex[np.ndarray, " n"]
        _, response = scipy.signal.freqs_zpk(zeros, poles, gain, 2 * np.pi * frequency_hz)
        return response

    def power_response(self, frequency_hz: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the ratio of powers behind the filter and before it."""
        raised: Float[np.ndarray, " n"] = np.abs(frequency_hz / self.corner_hz) ** (2 * self.order)
        return raised / (1 + raised)

    def filtered(self, paths: Paths, chirp: Chirp) -> Paths:
        """Return paths with the gains that their beats have behind the filter."""
        response = self.response(beat_phase(paths, chirp).frequency_hz)
        # An up-sweep's beat has the conjugate of a path's gain.
        return replace(paths, gain=paths.gain * (np.conj(response) if chirp.direction > 0 else response))

    def shaped(
        self, noise: Inexact[np.ndarray, "pulse sample"], sampling_rate_hz: float
    ) -> Inexact[np.ndarray, "pulse sample"]:
        """Return noise that has passed the filter: stationary, so taken as periodic over the chirp."""
        samples = noise.shape[1]
        if np.iscomplexobj(noise):
            # I/Q samples stand for beats from zero to the sampling rate.
            response = self.response(np.arange(samples) * (sampling_rate_hz / samples))
            return scipy.fft.ifft(scipy.fft.fft(noise) * response)
        response = self.response(scipy.fft.rfftfreq(samples, 1 / sampling_rate_hz))
        return scipy.fft.irfft(scipy.fft.rfft(noise) * response, samples)


def build_high_pass(table: ReceiverTable) -> HighPass | None:
    """Return the high-pass of a scenario; None without one."""
    if table.high_pass_corner_hz == 0:
        return None
    return HighPass(corner_hz=table.high_pass_corner_hz, order=table.high_pass_order)
