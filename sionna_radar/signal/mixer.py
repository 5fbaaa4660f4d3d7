"""The mixer with a non-ideal oscillator: beats of echoes, leakage and interferers with their phase errors.

The factor exp(j (e(t) - e(t - tau))) of an oscillator's phase e is smooth in the delay tau. It is computed at delays a
fixed step apart, and between them interpolated by cubic polynomials: each path is shared among the four nearest
nodes, the paths of a node are summed as those of an ideal radar, and multiplied by the factor of the node. With
STEP_RAD radians of the fastest part of e in a step, that part of the factor is wrong by at most 3 / 128 STEP_RAD^4 of
its size, in the middle of a step, and slower ones by less. Where e(t) - e(t - tau) is itself small, at delays under a
step, at most STEP_RAD^3 / 12 of it is wrong.

Leakage from the transmitter follows paths of a fixed delay, the same in every sweep. They pass the mixer like any echo:
the phase noise of the oscillator mostly cancels at their short delay. `receiver_paths` gives the paths to a
receiver beside the first.

Waves of other radars in our receiver: bursts where their sweeps cross ours.

The incoming wave is mixed with the transmitted one, like an echo; the beat is the difference of two sweeps,
a chirp of the difference of their slopes, within the band of the receiver for the time it takes to cross it
(Brooker 2007, "Mutual interference of millimeter-wave radar systems", IEEE Trans. Electromagn. Compat. 49, 170-181).
Its power is that of one way: P G G_r lambda^2 / (4 pi r)^2 (Friis 1946).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Int
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.threads import over_rows
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.mimo_array import MimoArray
from sionna_radar.signal.beat import SampleGrid, analytic_beats
from sionna_radar.signal.oscillator import Oscillator, PhaseWaves
from sionna_radar.signal.stages import Received
from sionna_radar.tracing.paths import TARGET, Paths

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
        raise ScenarioError.of("interferers", message)
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
    received_turns = sweep.carrier_hz * t[point] + sweep.slope_hz_s * t[point] ** 2 / 2
    u = sweep_s[row, point]
    turns = received_turns - radar.carrier_hz * u - radar.slope_hz_s * u**2 / 2
    fading = np.cos(np.pi / 2 * np.maximum(outside_band[row, point], 0.0)) ** 2
    beat[row, point] = fading * np.exp(2j * np.pi * sweep.direction * np.mod(turns, 1.0))
    return beat


STEP_RAD = 0.5


@dataclass(frozen=True)
class Mixer:
    """Synthesises the beats of paths."""

    oscillator: Oscillator

    def __call__(self, received: Received) -> Received:
        """Return the beats on all points of the grid."""
        scale, paths, grid = self.oscillator.scale, received.paths, received.grid
        if scale != 1:
            paths = replace(paths, delay_s=paths.delay_s * scale, range_rate_mps=paths.range_rate_mps * scale)
        # Errors whose phase over the sweep is lost in rounding have no effect, and no finite delay step.
        turns = self.oscillator.fastest_hz(grid.wide) * grid.wide.duration_s
        if self.oscillator.ideal or turns <= np.finfo(float).eps:
            beat = analytic_beats(paths, received.pulses, grid.wide, grid.band_hz)
        else:
            beat = self._mixed(paths, received)
        amplitude = np.sqrt(received.transmit_power_w)
        samples = amplitude * beat if grid.chirp.sampling == "iq" else np.sqrt(2) * amplitude * beat.real
        return replace(received, samples=samples)

    def _mixed(self, paths: Paths, received: Received) -> Complex[np.ndarray, "pulse point"]:
        pulses, sweep = received.pulses, received.grid.wide
        beat = np.zeros((len(pulses), sweep.samples), dtype=np.complex128)
        waves = None
        if self.oscillator.noise is not None:
            waves = self.oscillator.noise.waves(
                received.seed, pulses.index, sweep.samples, sweep.sampling_rate_hz, received.sweep
            )
        step_s = STEP_RAD / (2 * np.pi * self.oscillator.fastest_hz(sweep))
        position = paths.delay_s / step_s
        cell = np.floor(position).astype(np.int64)
        order = np.argsort(cell, kind="stable")
        # All nodes that share a path; nodes between distant groups of paths have none.
        for node in np.unique(np.unique(cell)[:, None] + np.arange(-1, 3)):
            start, stop = np.searchsorted(cell, (node - 2, node + 2), sorter=order)
            members = np.sort(order[start:stop])
            node_paths = paths.rows(members)
            node_paths = replace(node_paths, gain=node_paths.gain * cubic_weights(position[members] - node))
            rows = np.flatnonzero(np.isin(pulses.index, node_paths.pulse))
            if len(rows):
                clean = analytic_beats(node_paths, pulses.rows(rows), sweep, received.grid.band_hz)
                over_rows(self._adding(beat, clean, rows, node * step_s, received.grid, waves), len(rows))
        return beat

    def _adding(
        self,
        beat: Complex[np.ndarray, "pulse point"],
        clean: Complex[np.ndarray, "row point"],
        rows: Int[np.ndarray, " row"],
        delay_s: float,
        grid: SampleGrid,
        waves: PhaseWaves | None,
    ) -> Callable[[int, int], None]:
        """Return a function that adds ideal beats of some pulses, times the oscillator factor of a delay, to `beat`."""
        sweep, error = grid.wide, self.oscillator.error
        bend = np.zeros(sweep.samples)
        if error is not None:
            # The delayed sweep has the error of the transmitted one; phase noise is that of the clock that both share.
            bend = error.phase(sweep.sample_time_s) - error.phase(sweep.sample_time_s - (delay_s - sweep.gate_s))

        def add(start: int, stop: int) -> None:
            phase = bend if waves is None else bend + waves.difference(delay_s, rows[start:stop])
            # A down-sweep has the opposite sign of phase.
            beat[rows[start:stop]] += clean[start:stop] * np.exp(1j * sweep.direction * phase)

        return add


def cubic_weights(distance: Float[np.ndarray, " path"]) -> Float[np.ndarray, " path"]:
    """Return the weight of a node for paths at distances from it, in steps: cubic interpolation, zero beyond two."""
    d = np.abs(distance)
    inner = (1 - d) * (1 + d) * (2 - d) / 2
    outer = (1 - d) * (2 - d) * (3 - d) / 6
    return np.where(d < 1, inner, np.where(d < 2, outer, 0.0))


@dataclass(frozen=True)
class Leakage:
    """Delays of the paths, and their powers over the transmitted one."""

    delay_s: Float[np.ndarray, " path"]
    power: Float[np.ndarray, " path"]

    def __call__(self, received: Received) -> Received:
        """Return the received signal with the leakage paths of each pulse added."""
        leaking = self.paths(received.pulses.index)
        return replace(received, paths=Paths.concatenate([received.paths, leaking]))

    def paths(self, pulse: Int[np.ndarray, " pulse"]) -> Paths:
        """Return the leaking paths of some pulses."""
        count = len(self.delay_s) * len(pulse)
        return Paths(
            pulse=np.repeat(pulse, len(self.delay_s)),
            delay_s=np.tile(self.delay_s, len(pulse)),
            gain=np.tile(np.sqrt(self.power).astype(np.complex128), len(pulse)),
            range_rate_mps=np.zeros(count),
            incidence_rad=np.full(count, np.nan),
            hit_m=np.full((count, 3), np.nan),
            surface=np.full(count, TARGET),
        )


def receiver_paths(paths: Paths, pulses: Pulses, array: MimoArray, receiver: int) -> Paths:
    """Return the paths of a block of pulses to one receiver of an array with its transmitter at the first, true pose.

    The way back is longer or shorter, by exact distances; a difference pattern weighs each path by its direction.
    """
    row, pose = pulses.row_of(paths.pulse), pulses.true
    away_m = np.einsum("nij,ni->nj", pose.R_world_antenna[row], paths.hit_m - pose.position_m[row])
    range_m = np.linalg.norm(away_m, axis=1)
    place_m = (array.receiver_m if array.true_receiver_m is None else array.true_receiver_m)[receiver]
    direction = away_m / range_m[:, None]
    later_s = array.steps_m(place_m[None], direction, range_m)[:, 0] / speed_of_light
    gain = paths.gain
    if array.mixing is not None:
        error = array.mixing[receiver, receiver]
        # The beats of an up-sweep have the conjugate of a path's gain.
        gain = gain * (error.conj() if array.direction > 0 else error)
    if array.difference and receiver > 0:
        pattern = array.difference[receiver - 1]
        gain = gain * pattern.at(direction[:, pattern.axis])
    return replace(paths, delay_s=paths.delay_s + later_s, gain=gain)
