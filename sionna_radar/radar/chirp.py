"""The linear FMCW sweep and its derived quantities."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.radar.antenna import Squint


@dataclass(frozen=True, kw_only=True)
class Chirp:
    """One linear sweep, sampled over its full duration.

    carrier_hz: the frequency in the middle of the sweep.
    centre_s: time from the pose of the pulse to the middle of the sweep; zero for a sawtooth.
    propagation_mps: speed of the wave; differs from air's only for recordings in another medium.
    gate_s: delay of the sweep that echoes are mixed with, and of the samples, after the transmitted sweep. An echo of
        the delay tau has the beat of one of tau - gate_s without a gate.
    squint: turn of the beam over the sweep; None for none. Gains of paths are then those of its mean antenna.
    """

    carrier_hz: float
    bandwidth_hz: float
    rate_hz: float
    samples: int
    sweep: Literal["up", "down"] = "up"
    sampling: Literal["real", "iq"] = "real"
    centre_s: float = 0.0
    propagation_mps: float = speed_of_light
    gate_s: float = 0.0
    squint: Squint | None = None

    @property
    def duration_s(self) -> float:
        """Duration of the sweep."""
        return 1 / self.rate_hz

    @property
    def wavelength_m(self) -> float:
        """Wavelength of the carrier."""
        return self.propagation_mps / self.carrier_hz

    @property
    def slope_hz_s(self) -> float:
        """Rate of change of frequency, positive for an up-sweep."""
        return self.bandwidth_hz * self.rate_hz * self.direction

    @property
    def direction(self) -> int:
        """1 for an up-sweep, -1 for a down-sweep."""
        return 1 if self.sweep == "up" else -1

    @property
    def sampling_rate_hz(self) -> float:
        """Samples per second of the beat signal."""
        return self.samples * self.rate_hz

    @property
    def sample_time_s(self) -> Float[np.ndarray, " sample"]:
        """Sampling times from the middle of the sweep, which is sample `samples // 2`."""
        return (np.arange(self.samples) - self.samples // 2) / self.sampling_rate_hz

    @property
    def range_resolution_m(self) -> float:
        """Range corresponding to one beat period per sweep: c / (2 B)."""
        return self.propagation_mps / (2 * self.bandwidth_hz)

    @property
    def range_cells(self) -> int:
        """Number of unambiguous range cells of the samples."""
        return self.samples // (2 if self.sampling == "real" else 1)

    @property
    def beat_per_metre_hz(self) -> float:
        """Beat frequency per metre of range: 2 B / (c T)."""
        return 2 * self.bandwidth_hz * self.rate_hz / self.propagation_mps

    @property
    def max_range_m(self) -> float:
        """Unambiguous range: that of the highest beat frequency of the sampling."""
        return self.gate_m + self.samples * self.range_resolution_m / (2 if self.sampling == "real" else 1)

    @property
    def gate_m(self) -> float:
        """Range of the gate, whose beat is zero."""
        return self.gate_s * self.propagation_mps / 2

    @property
    def first_cell(self) -> int:
        """Number of the first range cell at or behind the gate; cell k lies at k c / (2 B) with and without it."""
        return math.ceil(self.gate_s * self.bandwidth_hz - 1e-6)

    @property
    def lead_cells(self) -> float:
        """Range cells from the gate to the first cell, less than one: the gate may lie between cells."""
        lead = self.first_cell - self.gate_s * self.bandwidth_hz
        return lead if lead > 1e-6 else 0.0

    def doppler_hz(self, range_rate_mps: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the Doppler part of the beat frequency: 2 f0 v / c, with opposite sign on a down-sweep.

        Source: Rouveure et al. 2017, eq. 2, with the sign of the range rate: an approaching target appears
        too near on an up-sweep and too far on a down-sweep.
        """
        return self.direction * 2 * self.carrier_hz * range_rate_mps / self.propagation_mps

    def doppler_range_m(self, range_rate_mps: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the range shift of an echo by its Doppler frequency."""
        return self.doppler_hz(range_rate_mps) / self.beat_per_metre_hz

    @property
    def doppler_range_s(self) -> float:
        """Range shift per range rate, m per m/s."""
        return float(self.doppler_range_m(np.ones(1))[0])


def used(chirp: Chirp, first: int, last: int) -> Chirp:
    """Return the part of a sweep between two samples (`last` excluded); its time counts from its own middle."""
    samples = last - first
    fraction, middle_s = samples / chirp.samples, chirp.sample_time_s[first] + (samples // 2) / chirp.sampling_rate_hz
    return replace(
        chirp,
        carrier_hz=chirp.carrier_hz + chirp.slope_hz_s * float(middle_s),
        bandwidth_hz=chirp.bandwidth_hz * fraction,
        rate_hz=chirp.rate_hz / fraction,
        samples=samples,
    )
