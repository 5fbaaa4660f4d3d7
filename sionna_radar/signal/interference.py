"""Waves of other radars in our receiver: bursts where their sweeps cross ours.

The incoming wave is mixed with the transmitted one, like an echo; the beat is the difference of two sweeps,
a chirp of the difference of their slopes, within the band of the receiver for the time it takes to cross it
(Brooker 2007, "Mutual interference of millimeter-wave radar systems", IEEE Trans. Electromagn. Compat. 49, 170-181).
Its power is that of one way: P G G_r lambda^2 / (4 pi r)^2 (Friis 1946).
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.radar.antenna import Antenna
from sionna_radar.signal.beat import SampleGrid
from sionna_radar.signal.stages import Received

# Fraction of the grid's band at its edges over which bursts fade out; filters remove it.
FADED = 0.25
# Least number of points per crossing of the grid's band, so that instantaneous frequencies describe the burst.
MIN_POINTS = 100.0
# Largest number of points of a sweep on the finer grid.
MAX_POINTS = 2**23


@dataclass(frozen=True, kw_only=True)
class OtherRadar:
    """Another radar: its position, radiated power (EIRP) and sweep.

    slope_hz_s: zero for a steady carrier. period_s: of its sweeps. start_s: of one of them.
    """

    position_m: Float[np.ndarray, "3"]
    radiated_w: float
    carrier_hz: float
    slope_hz_s: float = 0.0
    period_s: float = np.inf
    start_s: float = 0.0

    def into_sweep(self, time_s: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the time from the middle of the current sweep."""
        if not np.isfinite(self.period_s):
            return time_s
        return np.mod(time_s - self.start_s, self.period_s) - self.period_s / 2


@dataclass(frozen=True, kw_only=True)
class Interference:
    """Interference of other radars.

    antennas: ours, or that of each beam of an electronic scan.
    """

    radars: tuple[OtherRadar, ...] = ()
    antennas: tuple[Antenna, ...] = ()

    def __call__(self, received: Received) -> Received:
        """Return the received signal with the interference bursts of the other radars added."""
        samples = received.signal
        for radar in self.radars:
            power_w, range_m, rate_mps = self.arriving(radar, received.pulses, received.chirp.wavelength_m)
            beat = np.sqrt(power_w)[:, None] * _band_limited(radar, received.pulses, received.grid, range_m, rate_mps)
            samples = samples + (beat if np.iscomplexobj(samples) else np.sqrt(2) * beat.real)
        return replace(received, samples=samples)

    def arriving(
        self, radar: OtherRadar, pulses: Pulses, wavelength_m: float
    ) -> tuple[Float[np.ndarray, " pulse"], Float[np.ndarray, " pulse"], Float[np.ndarray, " pulse"]]:
        """Return the power received from a radar in each pulse, its range and its range rate."""
        pose = pulses.true
        offset_m = radar.position_m - pose.position_m
        # Nearer than a wavelength there is no far field.
        range_m = np.maximum(np.linalg.norm(offset_m, axis=1), wavelength_m)
        toward = offset_m / range_m[:, None]
        direction = np.einsum("nij,ni->nj", pose.R_world_antenna, toward)
        gain = np.zeros(len(pulses))
        beam = np.zeros(len(pulses), dtype=np.int64) if pulses.beam is None else pulses.beam
        for beam_index in np.unique(beam):
            gain[beam == beam_index] = self.antennas[beam_index].receive_gain(direction[beam == beam_index])
        power_w = radar.radiated_w * gain * (wavelength_m / (4 * np.pi * range_m)) ** 2
        return power_w, range_m, -np.einsum("ni,ni->n", pose.velocity_mps, toward)


def _band_limited(
    radar: OtherRadar,
    pulses: Pulses,
    grid: SampleGrid,
    range_m: Float[np.ndarray, " pulse"],
    rate_mps: Float[np.ndarray, " pulse"],
) -> Complex[np.ndarray, "pulse point"]:
    """Return the beats of a radar's wave on the points of a grid, synthesised on a finer one for fast crossings.

    A chirp crosses the band in band^2 / |difference of slopes| points; with few points its spectrum is far wider than
    the band, and an instantaneous frequency is undefined. The finer grid has many points per crossing, and an ideal
    filter then selects the band of the coarser.
    """
    sweep = grid.wide
    crossing = sweep.sampling_rate_hz**2 / max(abs(sweep.slope_hz_s - radar.slope_hz_s), 1e-300)
    finer = max(1, int(np.ceil(np.sqrt(MIN_POINTS / crossing))))
    if finer == 1:
        return _beat(radar, pulses, grid, range_m, rate_mps)
    if finer * sweep.samples > MAX_POINTS:
        message = f"a slope of {radar.slope_hz_s:.3g} Hz/s takes over {MAX_POINTS:,} points; lower bandwidth_hz"
        raise ScenarioError([Problem("interferers", message)])
    fine, points = replace(grid, oversampling=finer * grid.oversampling), sweep.samples
    # The lowest frequency of the coarser band, in steps of the transform.
    lowest = round(grid.band_hz[0] * points / sweep.sampling_rate_hz)
    bins = np.arange(lowest, lowest + points)
    beat = np.empty((len(pulses), points), dtype=np.complex128)
    for row in range(len(pulses)):
        single = slice(row, row + 1)
        spectrum = scipy.fft.fft(_beat(radar, pulses.rows(single), fine, range_m[single], rate_mps[single])[0])
        folded = np.zeros(points, dtype=np.complex128)
        folded[bins % points] = spectrum[bins % len(spectrum)] / finer
        beat[row] = scipy.fft.ifft(folded)
    return beat


def _beat(
    radar: OtherRadar,
    pulses: Pulses,
    grid: SampleGrid,
    range_m: Float[np.ndarray, " pulse"],
    rate_mps: Float[np.ndarray, " pulse"],
) -> Complex[np.ndarray, "pulse point"]:
    """Return the beats of a radar's wave of unit power with our sweeps, zero outside the band of the grid."""
    sweep = grid.wide
    t = sweep.sample_time_s
    transmit_s = (pulses.time_s + sweep.centre_s - range_m / speed_of_light)[:, None]
    sweep_s = radar.into_sweep(transmit_s + t * (1 - rate_mps[:, None] / speed_of_light))
    between_hz = sweep.direction * (
        sweep.carrier_hz + sweep.slope_hz_s * t - radar.carrier_hz - radar.slope_hz_s * sweep_s
    )
    half_hz = sweep.sampling_rate_hz / 2
    # I/Q samples hold beats around the middle of their band.
    middle_hz = grid.chirp.sampling_rate_hz / 2 if sweep.sampling == "iq" else 0.0
    outside_band = (np.abs(between_hz - middle_hz) / half_hz - (1 - FADED)) / FADED
    beat = np.zeros(sweep_s.shape, dtype=np.complex128)
    row, point = np.nonzero(outside_band < 1)
    own_turns = sweep.carrier_hz * t[point] + sweep.slope_hz_s * t[point] ** 2 / 2
    u = sweep_s[row, point]
    turns = own_turns - radar.carrier_hz * u - radar.slope_hz_s * u**2 / 2
    fading = np.cos(np.pi / 2 * np.maximum(outside_band[row, point], 0.0)) ** 2
    beat[row, point] = fading * np.exp(2j * np.pi * sweep.direction * np.mod(turns, 1.0))
    return beat
