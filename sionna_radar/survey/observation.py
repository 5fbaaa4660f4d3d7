"""Observing a prepared survey: the echoes that its sensor returns, segment by segment of the flight.

A segment is some consecutive blocks of pulses. What was observed over one is packed as bytes, which a worker returns
and from which an interrupted survey goes on.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool

from sionna_radar.accuracy.truth import Comparison, Counted, Tally
from sionna_radar.detection.echoes import Echoes, Profiles, VolumeInFront
from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import Failure, Task
from sionna_radar.flight.pulses import Pulses, PulseSchedule
from sionna_radar.foundation.columns import OF, columns_of, packed, table_of
from sionna_radar.foundation.errors import PluginError
from sionna_radar.foundation.numerics import on_one_thread
from sionna_radar.foundation.progress import advance, stage, timed
from sionna_radar.foundation.threads import beside, cores
from sionna_radar.mapping.points import Points, locate
from sionna_radar.scenario import Scenario
from sionna_radar.survey.preparation import CustomParts, Prepared, prepare
from sionna_radar.survey.sensors.sensor import Observation, Sensor, SensorWithLookahead

# Blocks of a segment, so that a long survey has not too many, and the least number of segments of a short one.
SEGMENT_BLOCKS, MIN_SEGMENTS = 8, 16
# Poses alone are small: placing takes many at once.
PLACED_AT_ONCE = 4096
# How recorders keep the samples of beat signals.
SampleType = Literal["float64", "float32", "int16"]


@dataclass(frozen=True, kw_only=True)
class Segment:
    """What a sensor observed over some consecutive blocks of pulses.

    echoes: sorted by pulse, not corrected for Doppler; profiles: around them, where the map wants them.
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


def _segment_and_counts(content: bytes) -> tuple[Segment, Counted]:
    """Return a segment, and the true hits that were counted over it, from their bytes."""
    columns = columns_of(content)
    return _segment_of(columns), table_of(Counted, "counted", columns)


def _segment_of(columns: dict[str, Any]) -> Segment:
    """Return the segment that was packed as `seen`."""
    profiles, of_profiles = None, f"seen{OF}profiles"
    if f"{of_profiles}{OF}pulse" in columns:
        inner = f"{of_profiles}{OF}volume"
        volume = table_of(VolumeInFront, inner, columns) if f"{inner}{OF}power" in columns else None
        profiles = table_of(Profiles, of_profiles, columns, volume=volume)
    return Segment(
        echoes=table_of(Echoes, f"seen{OF}echoes", columns),
        profiles=profiles,
        **{name: int(columns[f"seen{OF}{name}"]) for name in ("lost", "saturated_pulses", "saturated_samples")},
    )


@runtime_checkable
class Recorder(Protocol):
    """Keeps one kind of what a survey observes, such as its beat signals; see `sionna_radar.survey.recordings`."""

    def write(self, pulses: Pulses, seen: Observation) -> None:
        """Keep a block of pulses."""
        ...

    def finish(self, comparison: Comparison) -> None:
        """Keep what is known after the flight, and close the file."""
        ...

    def close(self) -> None:
        """Close the file as it is."""
        ...


@dataclass(frozen=True, kw_only=True)
class ObservedBlock:
    """A block of pulses and what the sensor observed; its echoes are not corrected for motion."""

    pulses: Pulses
    observation: Observation


def observe_blocks(blocks: Iterable[Pulses], sensor: Sensor) -> Iterator[ObservedBlock]:
    """Yield blocks of pulses as the sensor observes them.

    A `SensorWithLookahead` is told of each block before it observes the one in front of it, and may begin with it in
    another thread, if there is more than one core to do so.
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
class Observed:
    """What a sensor observed in a survey, independent of the measured pose.

    echoes: sorted by pulse, not corrected for Doppler.
    profiles: range profiles around them, where the scenario's map models whole echoes; else None.
    lit: cells of the DEM that the beam reached; silent: those that it reached in pulses without an echo.
    paths: how many were traced.
    rain_echoes: how many of the echoes hold more of rain than of anything else, where nothing is done about rain.
    lost_to_rain: pulses without an echo because rain masks the ground.
    saturated_pulses, saturated_samples: those that the receiver's converter clipped.
    """

    echoes: Echoes
    profiles: Profiles | None
    lit: Bool[np.ndarray, "row column"]
    silent: Bool[np.ndarray, "row column"]
    paths: int
    rain_echoes: int
    lost_to_rain: int = 0
    saturated_pulses: int = 0
    saturated_samples: int = 0

    @property
    def behind_volume(self) -> bool:
        """Whether its profiles are of ground behind a volume of rain."""
        return self.profiles is not None and self.profiles.volume is not None

    def packed(self) -> bytes:
        """Return its bytes, from which `unpacked` makes it again, bit for bit."""
        seen = Segment(
            echoes=self.echoes,
            profiles=self.profiles,
            lost=self.lost_to_rain,
            saturated_pulses=self.saturated_pulses,
            saturated_samples=self.saturated_samples,
        )
        return packed(seen=seen, lit=self.lit, silent=self.silent, paths=self.paths, rain_echoes=self.rain_echoes)

    @staticmethod
    def unpacked(content: bytes) -> "Observed":
        """Return what was observed from its bytes."""
        columns = columns_of(content)
        seen = _segment_of(columns)
        return Observed(
            echoes=seen.echoes,
            profiles=seen.profiles,
            lit=columns["lit"],
            silent=columns["silent"],
            paths=int(columns["paths"]),
            rain_echoes=int(columns["rain_echoes"]),
            lost_to_rain=seen.lost,
            saturated_pulses=seen.saturated_pulses,
            saturated_samples=seen.saturated_samples,
        )


@on_one_thread
def observe(prepared: Prepared, execution: Execution, recorders: Sequence[Recorder] = ()) -> tuple[Sensor, Observed]:
    """Return the sensor of a survey and what it observed, the same bits in this process or on workers.

    While workers begin, this process builds the sensor, for what follows the flight.

    Parameters
    ----------
    prepared:
        The survey.
    execution:
        Segments are kept among its checkpoints, and shared among its workers.
    recorders:
        What keeps more of each block: then this process flies the survey as a whole.

    Raises
    ------
    PluginError
        Parts of the scenario were replaced from Python, which workers do not have.
    RadarError
        A segment cannot be flown.

    """
    if recorders:
        execution = Execution(block_size=execution.block_size)
    scenario = prepared.scenario.model_dump_json() if execution.distributed else ""
    segments = segments_of(prepared, execution.block_size)
    tasks: dict[str, Task] = {key_of(blocks): {"scenario": scenario, "blocks": blocks} for blocks in segments}
    steps = {key_of(blocks): blocks[-1][1] - blocks[0][0] for blocks in segments}
    with stage("tracing", len(prepared)):
        if execution.distributed:
            refuse_custom(prepared.custom)
            building = beside(prepared.build_sensor)
            with timed("workers"):
                found = _results(execution, tasks, segment_task, steps)
            sensor = building()
        else:
            with timed("prepare"):
                sensor = prepared.build_sensor()
            missing = execution.missing(tasks)
            flown = _Flight(prepared, sensor, [block for key in missing for block in tasks[key]["blocks"]], recorders)
            found = _results(execution, tasks, flown.segment, steps)
    tally = Tally(prepared.truth, prepared.receiver.chirp)
    seen = []
    for segment, counted in (found[key] for key in tasks):
        seen.append(segment)
        tally.add_counted(counted)
    whole = Segment.joined(seen)
    return sensor, Observed(
        echoes=whole.echoes,
        profiles=whole.profiles,
        lit=tally.lit(),
        silent=tally.silent(),
        paths=tally.paths,
        rain_echoes=tally.rain_echoes,
        lost_to_rain=whole.lost,
        saturated_pulses=whole.saturated_pulses,
        saturated_samples=whole.saturated_samples,
    )


def _results(
    execution: Execution, tasks: dict[str, Task], work: Callable[[Task], bytes], steps: dict[str, int]
) -> dict[str, tuple[Segment, Counted]]:
    found = {}
    for key, result in execution.over(tasks, work, steps=steps):
        if isinstance(result, Failure):
            raise result.error()
        found[key] = _segment_and_counts(result)
    return found


def segments_of(prepared: Prepared, block_size: int) -> list[list[tuple[int, int]]]:
    """Return the blocks of each segment of a survey, by their first pulses and their ends."""
    chirps = 1 if prepared.bursts is None else prepared.bursts.chirps
    bounds = list(prepared.flight.line_bounds(max(1, block_size // chirps)))
    count = min(SEGMENT_BLOCKS, -(-len(bounds) // MIN_SEGMENTS))
    return [bounds[first : first + count] for first in range(0, len(bounds), count)]


def key_of(blocks: Sequence[tuple[int, int]]) -> str:
    """Return the key of a segment among the checkpoints of its survey."""
    return f"blocks {list(blocks)}"


def refuse_custom(custom: CustomParts) -> None:
    """Raise PluginError for parts given in Python: workers have what a scenario names, and packages registered."""
    replaced = custom.described()
    if replaced:
        message = (
            f"{', '.join(replaced)} replaced from Python: workers do not have it; fly without them, or register it in "
            "a package with the entry point sionna_radar.plugins that they have, too"
        )
        raise PluginError(message)


@on_one_thread
def segment_task(task: Task) -> bytes:
    """Return the bytes of a segment that a worker flies."""
    prepared, sensor = on_this_worker(task["scenario"])
    return _Flight(prepared, sensor, [(first, end) for first, end in task["blocks"]]).segment(task)


@lru_cache(maxsize=1)
def on_this_worker(scenario: str) -> tuple[Prepared, Sensor]:
    """Return a prepared survey and its sensor: a worker flies many segments of one."""
    prepared = prepare(Scenario.model_validate_json(scenario))
    return prepared, prepared.build_sensor()


class _Flight:
    """Observes blocks of pulses in their order, and counts the true hits; recorders keep more of each."""

    def __init__(
        self,
        prepared: Prepared,
        sensor: Sensor,
        blocks: Sequence[tuple[int, int]],
        recorders: Sequence[Recorder] = (),
    ) -> None:
        self._prepared, self._sensor, self._recorders = prepared, sensor, recorders
        self._tally = Tally(prepared.truth, prepared.receiver.chirp)
        self._observed = observe_blocks((prepared.flight.pulses(np.arange(*block)) for block in blocks), sensor)

    def segment(self, task: Task) -> bytes:
        """Return the bytes of the next segment."""
        seen = []
        for first, end in task["blocks"]:
            seen.append(self._counted(next(self._observed)))
            advance(end - first)
        return packed(seen=Segment.joined(seen), counted=self._tally.taken())

    def _counted(self, block: ObservedBlock) -> Segment:
        """Return the echoes, profiles and counts of a block, after tallying and recording it."""
        pulses, seen = block.pulses, block.observation
        lost = 0
        with timed("map"):
            self._tally.add(seen.paths, pulses)
            self._tally.add_silence(seen.paths, pulses, seen.echoes)
        with timed("record"):
            for recorder in self._recorders:
                recorder.write(pulses, seen)
        if seen.through_volume:
            lost = len(pulses) - len(np.unique(seen.echoes.pulse))
        else:
            corrected = self._sensor.correct(seen.echoes, pulses.index, pulses.measured)
            self._tally.add_echoes(corrected, seen.paths)
        saturated = np.zeros(1, dtype=np.int64) if seen.saturated is None else seen.saturated
        return Segment(
            echoes=seen.echoes,
            profiles=seen.profiles if self._prepared.mapper.keeps_profiles else None,
            lost=lost,
            saturated_pulses=int(np.count_nonzero(saturated)),
            saturated_samples=int(saturated.sum()),
        )


def place(echoes: Echoes, sensor: Sensor, schedule: PulseSchedule, *, block_size: int = PLACED_AT_ONCE) -> Points:
    """Correct and locate echoes by the poses that a schedule's navigation reports."""
    located = []
    for pulses in schedule.blocks(block_size):
        own = echoes.of_pulses(pulses.index)
        corrected = sensor.correct(own, pulses.index, pulses.measured)
        located.append(locate(corrected, pulses.index, pulses.measured))
    return Points.concatenate(located)
