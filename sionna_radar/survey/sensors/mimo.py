"""The MIMO sensor: an array of transmitters and receivers that maps without scanning; its pulses are frames.

Paths are traced once a frame, from the pose in its middle: all chirps, transmitters and receivers share the scatterers
(`signal.array_beats`). Those of a block, which are few, are kept for whoever records them.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Complex, Int

from sionna_radar.detection.angle.array_arrival import ArrayEstimator
from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.pulses import Bursts, Pose, Pulses
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.randomness import Stream, pulse_generators
from sionna_radar.foundation.stopwatch import timed
from sionna_radar.radar.mimo_array import MimoArray
from sionna_radar.signal.array_beats import FramePaths, array_beats
from sionna_radar.survey.sensors.sensor import Observation, SensorInputs
from sionna_radar.survey.sensors.sweeps import ChirpRecord
from sionna_radar.tracing.effects.volume_echo import spread_over_beam
from sionna_radar.tracing.paths import Paths


class Mimo:
    """Traces, receives and processes frames; see the module docstring."""

    def __init__(self, inputs: SensorInputs, frames: Bursts, module: MimoArray, estimator: ArrayEstimator) -> None:
        self._receiver, self._detector, self._frames = inputs.receiver, inputs.detector, frames
        self._module, self._engine, self._expected = module, inputs.engine, inputs.expected_ground
        self.tracer, self.estimator = inputs.tracer(), estimator
        # Dr.Jit's state belongs to a thread.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="trace")

    def observe(self, pulses: Pulses) -> Observation:
        """Return the points of a block of frames."""
        with timed("trace"):
            paths = self._thread.submit(self._trace, pulses).result()
        with timed("synthesise"):
            frames = np.stack([self._received(paths, pulses.rows(np.array([row]))) for row in range(len(pulses))])
        with timed("detect"):
            echoes = self.estimator.find_all(frames, pulses, self._expected)
        return Observation(paths=paths, echoes=echoes, frames=frames)

    def frame(self, pulses: Pulses) -> Complex[np.ndarray, "chirp rx sample"]:
        """Return the beat signals of one frame, sqrt(W), chirp by chirp."""
        return self._received(self._thread.submit(self._trace, pulses).result(), pulses)

    def _trace(self, pulses: Pulses) -> Paths:
        """Return the paths of frames; rain, which is traced on the beam's axis, fills the beam."""
        engine = self._engine
        return spread_over_beam(self.tracer.trace(pulses), pulses, engine.antenna, engine.caster, engine.seed)

    def _received(self, paths: Paths, frame: Pulses) -> Complex[np.ndarray, "chirp rx sample"]:
        receiver = self._receiver
        frame_paths = paths.rows(slice(*np.searchsorted(paths.pulse, [frame.index[0], frame.index[0] + 1])))
        chirps = self._frames.chirps_of(frame)
        beats = array_beats(FramePaths.of(frame_paths, frame.true), chirps.true, self._module, receiver.chirp)
        beats *= np.sqrt(receiver.transmit_power_w)
        if receiver.chirp.sampling == "real":
            beats = np.sqrt(2) * beats.real
        # One draw covers all receivers of a chirp.
        sigma = np.sqrt(receiver.noise_power_w * 8 / beats.itemsize)
        for clean, generator in zip(beats, pulse_generators(receiver.seed, Stream.NOISE, chirps.index), strict=True):
            parts = generator.standard_normal(clean.size * (beats.itemsize // 8))
            clean += sigma * parts.view(beats.dtype).reshape(clean.shape)
        return beats

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return points without the Doppler shift of still ground in their directions."""
        return self._detector.correct(echoes, pulse, measured)

    def record_chirp(self, pulses: Pulses) -> ChirpRecord | None:
        """Return None: a chirp alone is not what an array detects in."""
        return None

    def release_memory(self) -> None:
        """Release memory; it is allocated again when more frames are observed."""
        self._thread.submit(self.tracer.release_memory).result()


def build_mimo(inputs: SensorInputs) -> Mimo:
    """Return the module of a scenario."""
    if not isinstance(inputs.angle, ArrayEstimator) or inputs.module is None or inputs.bursts is None:
        raise ScenarioError.of("radar.array", "missing; sensor = 'mimo' needs its elements")
    if inputs.receiver.chain is not None or inputs.receiver.high_pass is not None:
        message = "an array's receivers support thermal noise and radar.array only; remove the other keys"
        raise ScenarioError.of("radar.receiver", message)
    return Mimo(inputs, inputs.bursts, inputs.module, inputs.angle)
