"""The radar sensor: trace, synthesise and detect pulses of one sweep, or of an up- and a down-sweep."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from jaxtyping import Inexact, Int

from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.detector import PairedEchoes
from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.stopwatch import timed
from sionna_radar.signal.mixer import receiver_paths
from sionna_radar.signal.receiver import Reception
from sionna_radar.survey.sensors.sensor import Observation, SensorInputs
from sionna_radar.survey.sensors.sweeps import Beats, ChirpRecord, SweepDetector
from sionna_radar.tracing.paths import Paths
from sionna_radar.tracing.tracer import SteeredTracer, Tracer


class Radar:
    """Trace the paths of pulses, synthesise beat signals, and detect echoes.

    Tracing and synthesis run in threads of their own, one block ahead of detection.

    Of a single sweep a pulse the measured velocity takes the Doppler shift out; the two sweeps of a triangle do so
    themselves. The beam stands still during a pair, as it does during a single sweep. With receivers beside the first,
    an echo becomes points in the directions that these tell. A pulse may be several chirps, which are averaged.
    """

    def __init__(self, inputs: SensorInputs) -> None:
        self._receiver, self._angle, self._array = inputs.receiver, inputs.angle, inputs.module
        self._bursts = inputs.bursts
        self.tracer = inputs.tracer()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="trace")
        self._receiving = ThreadPoolExecutor(1, thread_name_prefix="receive")
        self._expected: deque[tuple[Pulses, Future[Paths], Future[Reception]]] = deque()
        self.sweeps = SweepDetector(
            detector=inputs.detector,
            sweeps=inputs.receiver.sweeps,
            schedule=inputs.schedule,
            expected_ground=inputs.expected_ground,
            beats=_beats_of(inputs, self.tracer, self._thread),
            bursts=inputs.bursts,
        )

    def expect(self, pulses: Pulses) -> None:
        """Start tracing a block of pulses before it is observed."""
        sent = self._sent(pulses)
        paths = self._thread.submit(self.tracer.trace, sent)
        received: Future[Reception] = self._receiving.submit(lambda: self._receiver.reception(paths.result(), sent))
        self._expected.append((pulses, paths, received))

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses."""
        if self._expected and self._expected[0][0] is pulses:
            _, traced, received = self._expected.popleft()
            with timed("trace"):
                paths = traced.result()
            with timed("synthesise"):
                reception = received.result()
        else:
            with timed("trace"):
                paths = self._trace(pulses)
            with timed("synthesise"):
                reception = self._receiver.reception(paths, self._sent(pulses))
        if isinstance(self._angle, AngleEstimator):
            return self._in_directions(self._angle, paths, reception, pulses)
        with timed("detect"):
            detections = self.sweeps.detect(reception.beats, pulses)
        return Observation(
            paths=self._of_pulses(paths),
            echoes=detections.echoes,
            profiles=detections.profiles,
            through_volume=detections.through_volume,
            beats=tuple(reception.beats),
            saturated=self._counted(reception),
        )

    def _in_directions(self, angle: AngleEstimator, paths: Paths, reception: Reception, pulses: Pulses) -> Observation:
        """Return points along the echoes of a block, from the signals of all receivers."""
        with timed("synthesise"):
            sent, array = self._sent(pulses), self._array
            assert array is not None
            sides = [
                self._receiver.beat(receiver_paths(paths, sent, array, channel), sent, channel)
                for channel in range(1, len(array.receiver_m))
            ]
        with timed("detect"):
            beats = (reception.beats[0], *sides)
            echoes = self.sweeps.directions(angle, beats, pulses)
        return Observation(
            paths=self._of_pulses(paths),
            echoes=echoes,
            beats=tuple(reception.beats),
            frames=np.stack(beats, axis=1)[:, None],
            saturated=self._counted(reception),
        )

    def release_memory(self) -> None:
        """Release memory; it is allocated again when more pulses are observed."""
        self._thread.submit(self.tracer.release_memory).result()

    def beat(self, pulses: Pulses) -> Inexact[np.ndarray, "pulse sample"]:
        """Return the beat signals of the first sweep of pulses, after removal of leakage and interference."""
        received = self._receiver.beat(self._trace(pulses), self._sent(pulses))
        return self.sweeps.cleaned([received], pulses)[0]

    def pairs(self, paths: Paths, pulses: Pulses) -> PairedEchoes:
        """Return the echoes of paths in pairs of sweeps, with their range rates."""
        return self.sweeps.pairs(self._receiver.beats(paths, self._sent(pulses)), pulses)

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return echoes without the Doppler shift of still ground."""
        return self.sweeps.correct(echoes, pulse, measured)

    def record_chirp(self, pulses: Pulses) -> ChirpRecord:
        """Return the chirp of one pulse, the rising half of a pair, with what is found in it."""
        return self.record_chirps(pulses)[0]

    def record_chirps(self, pulses: Pulses) -> list[ChirpRecord]:
        """Return the chirps of some pulses at once, as `record_chirp` does of one."""
        return self.sweeps.record_chirps(pulses)

    def _trace(self, pulses: Pulses) -> Paths:
        """Trace pulses in the one thread that does so."""
        return self._thread.submit(self.tracer.trace, self._sent(pulses)).result()

    def _sent(self, pulses: Pulses) -> Pulses:
        """Return the chirps of pulses."""
        return pulses if self._bursts is None else self._bursts.chirps_of(pulses)

    def _of_pulses(self, paths: Paths) -> Paths:
        """Return the paths of chirps as those of their pulses."""
        return paths if self._bursts is None else replace(paths, pulse=paths.pulse // self._bursts.chirps)

    def _counted(self, reception: Reception) -> Int[np.ndarray, " pulse"] | None:
        """Return the samples of each pulse that the converter clipped."""
        saturated = reception.saturated
        if saturated is None or self._bursts is None:
            return saturated
        return saturated.reshape(-1, self._bursts.chirps).sum(axis=1)


def _beats_of(
    inputs: SensorInputs, tracer: Tracer | SteeredTracer, thread: ThreadPoolExecutor
) -> Callable[[Pulses], Beats]:
    """Return a function that traces and receives pulses without keeping the radar, and so its threads, alive."""
    receiver, bursts = inputs.receiver, inputs.bursts

    def beats(pulses: Pulses) -> Beats:
        sent = pulses if bursts is None else bursts.chirps_of(pulses)
        return receiver.beats(thread.submit(tracer.trace, sent).result(), sent)

    return beats
