"""The mixer: echoes times the sweep that is being sent, with all that its oscillator adds.

The factor exp(j (e(t) - e(t - tau))) of an oscillator's phase e is smooth in the delay tau. It is computed at delays a
fixed step apart, and between them interpolated by cubic polynomials: each path is shared among the four nearest
nodes, the paths of a node are summed as those of an ideal radar, and multiplied by the factor of the node. With
STEP_RAD radians of the fastest part of e in a step, that part of the factor is wrong by at most 3 / 128 STEP_RAD^4 of
its size, in the middle of a step, and slower ones by less. Where e(t) - e(t - tau) is itself small, at delays under a
step, at most STEP_RAD^3 / 12 of it is wrong.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float

from sionna_radar.scenario.bases import StageParameters
from sionna_radar.signal.beat import analytic_beats
from sionna_radar.signal.oscillator import Oscillator, PhaseWaves, build_oscillator
from sionna_radar.signal.sample_grid import SampleGrid
from sionna_radar.signal.stages import Received, StageInputs, register_receiver_stage
from sionna_radar.tracing.paths import Paths

STEP_RAD = 0.5


@dataclass(frozen=True)
class Mixer:
    """Makes beats of paths."""

    oscillator: Oscillator

    def __call__(self, received: Received) -> Received:
        """Return the beats on all points of the grid."""
        scale, paths, grid = self.oscillator.scale, received.paths, received.grid
        if scale != 1:
            paths = replace(paths, delay_s=paths.delay_s * scale, range_rate_mps=paths.range_rate_mps * scale)
        if self.oscillator.ideal:
            beat = analytic_beats(paths, received.pulses, grid.wide)
        else:
            beat = self._mixed(paths, received)
        amplitude = np.sqrt(received.transmit_power_w)
        samples = amplitude * beat if grid.chirp.sampling == "iq" else np.sqrt(2) * amplitude * beat.real
        return replace(received, samples=samples)

    def _mixed(self, paths: Paths, received: Received) -> Complex[np.ndarray, "pulse point"]:
        pulses, wide = received.pulses, received.grid.wide
        beat = np.zeros((len(pulses), wide.samples), dtype=np.complex128)
        waves = None
        if self.oscillator.noise is not None:
            waves = self.oscillator.noise.waves(
                received.seed, pulses.index, wide.samples, wide.sampling_rate_hz, received.sweep
            )
        step_s = STEP_RAD / (2 * np.pi * self.oscillator.fastest_hz(wide))
        place = paths.delay_s / step_s
        # Every node that any path is shared with; nodes between two far groups of paths have none.
        cell = np.unique(np.floor(place).astype(np.int64))
        for node in np.unique(cell[:, None] + np.arange(-1, 3)):
            weight = shares(place - node)
            near = np.flatnonzero(weight)
            own = paths.rows(near)
            own = replace(own, gain=own.gain * weight[near])
            rows = np.flatnonzero(np.isin(pulses.index, own.pulse))
            if len(rows):
                factor = self._factor(node * step_s, received.grid, waves, rows)
                beat[rows] += analytic_beats(own, pulses.rows(rows), wide) * factor
        return beat

    def _factor(
        self, delay_s: float, grid: SampleGrid, waves: PhaseWaves | None, rows: np.ndarray
    ) -> Complex[np.ndarray, "row point"]:
        wide, error = grid.wide, self.oscillator.error
        phase: Float[np.ndarray, "row point"] = np.zeros((1, wide.samples))
        if error is not None:
            phase = phase + error.phase(wide.sample_time_s) - error.phase(wide.sample_time_s - delay_s)
        if waves is not None:
            phase = phase + waves.difference(delay_s, rows)
        # A down-sweep is mixed the other way round.
        factor: Complex[np.ndarray, "row point"] = np.exp(1j * wide.direction * phase)
        return factor


def shares(distance: Float[np.ndarray, " path"]) -> Float[np.ndarray, " path"]:
    """Return the share of a node in paths at distances from it, in steps: cubic interpolation, zero beyond two."""
    d = np.abs(distance)
    inner = (1 - d) * (1 + d) * (2 - d) / 2
    outer = (1 - d) * (2 - d) * (3 - d) / 6
    weight: Float[np.ndarray, " path"] = np.where(d < 1, inner, np.where(d < 2, outer, 0.0))
    return weight


@register_receiver_stage("mixer", StageParameters)
def build_mixer(_: StageParameters, given: StageInputs) -> Mixer:
    """Return the mixer of a scenario's radar."""
    radar, chirp = given.radar, given.sweeps[0]
    first, last = radar.used_samples
    whole = radar.samples_per_chirp
    middle = first + (last - first) // 2 - whole // 2
    rate_hz = chirp.sampling_rate_hz
    return Mixer(build_oscillator(radar.receiver.oscillator, whole / rate_hz, middle / rate_hz))
