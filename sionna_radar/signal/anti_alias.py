"""The low-pass in front of the converter: what it leaves of beats beyond the sampled band folds into it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.receiver import ReceiverTable


@dataclass(frozen=True, kw_only=True)
class AntiAlias:
    """A Butterworth low-pass: power response 1 / (1 + (f / corner)^(2 order)).

    With I/Q samples, which see beats from zero to the sampling rate, f counts from the middle of that band.
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
        """Return the power that passes at the end of a band so many times as wide as that of the samples."""
        edge_hz = oversampling * self.chirp.sampling_rate_hz / 2
        return float(1 / (1 + (edge_hz / self.corner_hz) ** (2 * self.order)))


def build_anti_alias(table: ReceiverTable, chirp: Chirp) -> AntiAlias | None:
    """Return the anti-alias filter of a scenario; None where it is ideal."""
    if table.anti_alias_corner_hz == 0:
        return None
    return AntiAlias(corner_hz=table.anti_alias_corner_hz, order=table.anti_alias_order, chirp=chirp)
