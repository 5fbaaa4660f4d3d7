"""Observation of a prepared survey: the echoes that its sensor returns, segment by segment.

A segment consists of consecutive blocks of pulses. Its observations are serialised where workers return them or
checkpoints hold them.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from sionna_radar.accuracy.truth import Comparison, Counted, Tally, TrueHits
from sionna_radar.detection.angle.array_arrival import ArrayEstimator
from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.echoes import Echoes, Profiles
from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import Task, Work
from sionna_radar.flight.pulses import Bursts, Pulses, PulseSequence
from sionna_radar.foundation.columns import OF, columns_of, packed, table_of
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.foundation.stopwatch import timed
from sionna_radar.foundation.threads import cores, in_background
from sionna_radar.scenario import Scenario
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.sensors.sensor import Observation, Sensor, SensorWithLookahead

# Most blocks of a segment, and fewest segments of a short survey.
SEGMENT_BLOCKS, MIN_SEGMENTS = 8, 16
# Data types of recorded beat signals.
SampleType = Literal["float64", "float32", "int16"]


@dataclass(frozen=True, kw_only=True)
class Segment:
    """Observations of a sensor over consecutive blocks of pulses.

    echoes: sorted by pulse, not corrected for Doppler; profiles: range profiles around them, if the map needs them.
    lost: pulses without an echo because rain masks the ground.
    saturated_pulses, saturated_samples: those that the receiver's converter clipped.
    """

    echoes: Echoes
    profiles: Profiles | None
    lost: int
    saturated_pulses: int = 0
    saturated_samples: int = 0

    @staticmethod
    def joined(segments: Sequence["Segment"]) -> "Segment":
        """Return the concatenation of segments in order."""
        profiles = [segment.profiles for segment in segments if segment.profiles is not None]
        return Segment(
            echoes=Echoes.concatenate([segment.echoes for segment in segments]),
            profiles=Profiles.concatenate(profiles) if profiles else None,
            lost=sum(segment.lost for segment in segments),
            saturated_pulses=sum(segment.saturated_pulses for segment in segments),
            saturated_samples=sum(segment.saturated_samples for segment in segments),
        )


def _segment_and_counts(content: bytes) -> tuple[Segment, Counted | None]:
    """Deserialise a segment and its tally of true hits, if any."""
    columns = columns_of(content)
    counted = table_of(Counted, "counted", columns) if f"counted{OF}paths" in columns else None
    return table_of(Segment, "seen", columns), counted


@runtime_checkable
class Recorder(Protocol):
    """Records one kind of data, such as beat signals; see `sionna_radar.survey.recordings`."""

    def write(self, pulses: Pulses, seen: Observation) -> None:
        """Record a block of pulses."""

    def finish(self, comparison: Comparison) -> None:
        """Write what is known after the flight, and close the file."""

    def close(self) -> None:
        """Close an unfinished file."""


@dataclass(frozen=True, kw_only=True)
class ObservedBlock:
    """A block of pulses and what the sensor observed; its echoes are not corrected for motion."""

    pulses: Pulses
    observation: Observation


def observe_blocks(blocks: Iterable[Pulses], sensor: Sensor) -> Iterator[ObservedBlock]:
    """Yield the blocks of pulses, in order, with their observations.

    With several cores, a `SensorWithLookahead` is given each block ahead of time, to start on it in another thread.
    """
    ahead = sensor if cores() > 1 and isinstance(sensor, SensorWithLookahead) else None
    coming = iter(blocks)
    current = next(coming, None)
    if ahead is not None and current is not None:
        ahead.expect(current)
    while current is not None:
        following = next(coming, None)
        if ahead is not None and following is not None:
            ahead.expect(following)
        yield ObservedBlock(pulses=current, observation=sensor.observe(current))
        current = following


@dataclass(frozen=True, kw_only=True)
class Observed(Segment):
    """Observations of a whole survey, independent of the measured pose; columns as in a segment.

    hits: true hits of the beam; None if unknown.
    """

    hits: TrueHits | None = None

    @property
    def behind_volume(self) -> bool:
        """Whether the profiles show ground behind a rain volume."""
        return self.profiles is not None and self.profiles.volume is not None

    def packed(self) -> bytes:
        """Serialise it exactly; `unpacked` is the inverse."""
        return packed(observed=self)

    @staticmethod
    def unpacked(content: bytes) -> "Observed":
        """Deserialise observations."""
        observed: Observed = table_of(Observed, "observed", columns_of(content))
        return observed


@runtime_checkable
class Source(Protocol):
    """Pulses and the sensor that observes them: a simulated survey or a recording."""

    @property
    def activity(self) -> str:
        """Name of the progress stage."""

    @property
    def flight(self) -> PulseSequence:
        """The pulses."""

    @property
    def bursts(self) -> Bursts | None:
        """The chirps of each pulse; None for one."""

    @property
    def angle(self) -> AngleEstimator | ArrayEstimator | None:
        """Estimator of directions, of a second receiver or of an array's frames; None for neither."""
        ...

    @property
    def keeps_profiles(self) -> bool:
        """Whether the DEM method uses range profiles around the echoes."""

    def document(self) -> Task:
        """Return the inputs from which a worker opens it, as JSON; PluginError for custom parts, which workers lack."""

    def build_sensor(self) -> Sensor:
        """Return a new sensor."""

    def tally(self) -> Tally | None:
        """Return an empty tally of true hits; None if the truth is unknown."""


@on_one_thread
def observe(
    source: Source, execution: Execution, recorders: Sequence[Recorder] = (), work: Work | None = None
) -> tuple[Sensor, Observed]:
    """Return the sensor of a survey and its observations; the same bits in this process and on workers.

    While workers run, this process builds the sensor, which later stages need.

    execution: provides checkpoints and workers for the segments.
    recorders: record further data; with any, this process simulates the whole survey.
    work: module-level function that observes a segment on a worker; default: of prepared surveys.

    Raises PluginError for custom parts, which workers lack, and RadarError if a segment cannot be simulated.
    """
    if recorders:
        execution = Execution(block_size=execution.block_size)
    document = source.document() if execution.distributed else {}
    segments = segments_of(source, execution.block_size)
    tasks: dict[str, Task] = {key_of(blocks): {**document, "blocks": blocks} for blocks in segments}
    steps = {key_of(blocks): blocks[-1][1] - blocks[0][0] for blocks in segments}
    with stage(source.activity, len(source.flight)):
        if execution.distributed:
            building = in_background(source.build_sensor)
            with timed("workers"):
                results = _results(execution, tasks, work or segment_task, steps)
            sensor = building()
        else:
            with timed("prepare"):
                sensor = source.build_sensor()
            blocks = [block for key in execution.missing(tasks) for block in tasks[key]["blocks"]]
            observer = SegmentObserver(source, sensor, blocks, recorders)
            if execution.checkpoints is None:
                # Nothing leaves this process.
                results = {key: observer.observed(task) for key, task in tasks.items()}
            else:
                results = _results(execution, tasks, observer.segment, steps)
    whole = Segment.joined([results[key][0] for key in tasks])
    tally = source.tally()
    for _, counted in (results[key] for key in tasks):
        if tally is not None and counted is not None:
            tally.add_counted(counted)
    return sensor, Observed(**vars(whole), hits=None if tally is None else tally.hits())


def _results(
    execution: Execution, tasks: dict[str, Task], work: Callable[[Task], bytes], steps: dict[str, int]
) -> dict[str, tuple[Segment, Counted | None]]:
    return {key: _segment_and_counts(content) for key, content in execution.done(tasks, work, steps=steps)}


def segments_of(source: Source, block_size: int) -> list[list[tuple[int, int]]]:
    """Return the blocks of each segment as (first pulse, end): whole scan lines, or frames of an array."""
    if isinstance(source.angle, ArrayEstimator):
        ends = range(0, len(source.flight), max(1, block_size // source.angle.array.chirps))
        bounds = list(pairwise([*ends, len(source.flight)]))
    else:
        chirps = 1 if source.bursts is None else source.bursts.chirps
        bounds = list(source.flight.line_bounds(max(1, block_size // chirps)))
    count = min(SEGMENT_BLOCKS, -(-len(bounds) // MIN_SEGMENTS))
    return [bounds[first : first + count] for first in range(0, len(bounds), count)]


def key_of(blocks: Sequence[tuple[int, int]]) -> str:
    """Return the key of a segment among the checkpoints of its survey."""
    return f"blocks {list(blocks)}"


@on_one_thread
def segment_task(task: Task) -> bytes:
    """Simulate a segment on a worker, and return it serialised."""
    prepared, sensor = on_this_worker(task["scenario"])
    return SegmentObserver(prepared, sensor, task["blocks"]).segment(task)


@lru_cache(maxsize=1)
def on_this_worker(scenario: str) -> tuple[Prepared, Sensor]:
    """Return a prepared survey and its sensor, cached for the segments of one survey."""
    prepared = prepare(Scenario.model_validate_json(scenario))
    return prepared, prepared.build_sensor()


class SegmentObserver:
    """Observe blocks of pulses in order, tally true hits, and forward blocks to recorders."""

    def __init__(
        self, source: Source, sensor: Sensor, blocks: Sequence[Sequence[int]], recorders: Sequence[Recorder] = ()
    ) -> None:
        self._sensor, self._recorders, self._keeps_profiles = sensor, recorders, source.keeps_profiles
        self._tally = source.tally()
        self._observed = observe_blocks((source.flight.pulses(np.arange(*block)) for block in blocks), sensor)

    def segment(self, task: Task) -> bytes:
        """Return the next segment and its tally of true hits, serialised."""
        seen, counted = self.observed(task)
        return packed(seen=seen, counted=counted)

    def observed(self, task: Task) -> tuple[Segment, Counted | None]:
        """Return the next segment and its tally of true hits, if any."""
        seen = []
        for first, end in task["blocks"]:
            seen.append(self._counted(next(self._observed)))
            advance(end - first)
        return Segment.joined(seen), None if self._tally is None else self._tally.taken()

    def _counted(self, block: ObservedBlock) -> Segment:
        """Return the echoes, profiles and counts of a block, after tallying and recording it."""
        pulses, seen = block.pulses, block.observation
        if self._tally is not None:
            with timed("map"):
                self._tally.add(seen.paths, pulses)
                self._tally.add_silence(seen.paths, pulses, seen.echoes)
        with timed("record"):
            for recorder in self._recorders:
                recorder.write(pulses, seen)
        if self._tally is not None:
            self._tally.add_looks(seen.echoes, seen.paths, pulses)
            if not seen.through_volume:
                self._tally.add_echoes(seen.echoes, seen.paths)
        saturated = np.zeros(1, dtype=np.int64) if seen.saturated is None else seen.saturated
        return Segment(
            echoes=seen.echoes,
            profiles=seen.profiles if self._keeps_profiles else None,
            lost=len(pulses) - len(np.unique(seen.echoes.pulse)) if seen.through_volume else 0,
            saturated_pulses=int(np.count_nonzero(saturated)),
            saturated_samples=int(saturated.sum()),
        )
