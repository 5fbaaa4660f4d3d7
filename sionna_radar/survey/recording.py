"""Flying a prepared survey: the echoes that its sensor observes, block by block, and their positions.

The observations over a stretch of the flight are packed as bytes, from which an interrupted survey goes on.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool

from sionna_radar.accuracy.truth import Comparison, Counted, Tally
from sionna_radar.detection.echoes import Echoes, Profiles, VolumeInFront
from sionna_radar.flight.pulses import Pulses, PulseSchedule
from sionna_radar.foundation.checkpoints import Checkpoints
from sionna_radar.foundation.columns import OF, columns_of, packed, table_of
from sionna_radar.foundation.numerics import on_one_thread
from sionna_radar.foundation.progress import Progress, Stopwatch, silent
from sionna_radar.foundation.threads import cores
from sionna_radar.mapping.points import Points, locate
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.sensors.sensor import Observation, Sensor


@dataclass(frozen=True, kw_only=True)
class Stretch:
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
    def joined(stretches: Sequence["Stretch"]) -> "Stretch":
        """Return the concatenation of stretches in order."""
        profiles = [one.profiles for one in stretches if one.profiles is not None]
        return Stretch(
            echoes=Echoes.concatenate([one.echoes for one in stretches]),
            profiles=Profiles.concatenate(profiles) if profiles else None,
            lost=sum(one.lost for one in stretches),
            saturated_pulses=sum(one.saturated_pulses for one in stretches),
            saturated_samples=sum(one.saturated_samples for one in stretches),
        )


@dataclass(frozen=True, kw_only=True)
class FinishedStretch:
    """A stretch, and the true hits that were counted over it."""

    seen: Stretch
    counted: Counted

    def packed(self) -> bytes:
        """Return its bytes, from which `unpacked` makes it again, bit for bit."""
        return packed(seen=self.seen, counted=self.counted)

    @staticmethod
    def unpacked(content: bytes) -> "FinishedStretch":
        """Return the stretch of some bytes."""
        columns = columns_of(content)
        return FinishedStretch(seen=stretch_of(columns), counted=table_of(Counted, "counted", columns))


def stretch_of(columns: dict[str, Any]) -> Stretch:
    """Return the stretch that was packed as `seen`."""
    profiles, of_profiles = None, f"seen{OF}profiles"
    if f"{of_profiles}{OF}pulse" in columns:
        inner = f"{of_profiles}{OF}volume"
        volume = table_of(VolumeInFront, inner, columns) if f"{inner}{OF}power" in columns else None
        profiles = table_of(Profiles, of_profiles, columns, volume=volume)
    return Stretch(
        echoes=table_of(Echoes, f"seen{OF}echoes", columns),
        profiles=profiles,
        **{name: int(columns[f"seen{OF}{name}"]) for name in ("lost", "saturated_pulses", "saturated_samples")},
    )


BLOCK_SIZE = 256
# Blocks that are kept together, so that a long survey has not too many parts, and a short one enough to share them.
STRETCH_BLOCKS, MIN_STRETCHES = 8, 16
# How recorders keep the samples of beat signals.
SampleType = Literal["float64", "float32", "int16"]


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


def fly(blocks: Iterator[Pulses], sensor: Sensor) -> Iterator[ObservedBlock]:
    """Yield blocks of pulses as the sensor observes them.

    A sensor with a method `expect` is told of each block before it observes the one in front of it, and may begin with
    it in another thread, if there is more than one core to do so.
    """
    expect = getattr(sensor, "expect", None) if cores() > 1 else None
    current = next(blocks, None)
    if expect is not None and current is not None:
        expect(current)
    while current is not None:
        following = next(blocks, None)
        if expect is not None and following is not None:
            expect(following)
        yield ObservedBlock(pulses=current, observation=sensor.observe(current))
        current = following


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What a sensor recorded in a survey, independent of the measured pose.

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
        seen = Stretch(
            echoes=self.echoes,
            profiles=self.profiles,
            lost=self.lost_to_rain,
            saturated_pulses=self.saturated_pulses,
            saturated_samples=self.saturated_samples,
        )
        return packed(seen=seen, lit=self.lit, silent=self.silent, paths=self.paths, rain_echoes=self.rain_echoes)

    @staticmethod
    def unpacked(content: bytes) -> "Recording":
        """Return the recording of some bytes."""
        columns = columns_of(content)
        seen = stretch_of(columns)
        return Recording(
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
def record(
    prepared: Prepared,
    sensor: Sensor,
    *,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    watch: Stopwatch | None = None,
    recorders: Sequence[Recorder] = (),
    parts: Checkpoints | None = None,
) -> Recording:
    """Fly a prepared survey and return what the sensor observed, block by block.

    Recorders keep more of it. Finished stretches of `STRETCH_BLOCKS` blocks are kept in `parts`, and those that are
    there already are not flown again.
    """
    watch = watch or Stopwatch()
    tally = Tally(prepared.truth(), prepared.receiver.chirp)
    flying = _Flying(prepared, sensor, tally, watch, recorders)
    stretches = stretches_of(prepared, block_size)
    kept = [None if parts is None else parts.get(key_of(stretch)) for stretch in stretches]
    wanted = (
        prepared.flight.pulses(np.arange(*block))
        for stretch, content in zip(stretches, kept, strict=True)
        if content is None
        for block in stretch
    )
    observed, found = fly(wanted, sensor), []
    progress("tracing", 0, len(prepared))
    for stretch, content in zip(stretches, kept, strict=True):
        if content is not None:
            finished = FinishedStretch.unpacked(content)
            found.append(finished.seen)
            tally.add_counted(finished.counted)
            progress("tracing", stretch[-1][1], len(prepared))
            continue
        for _, end in stretch:
            found.append(flying.counted(next(observed)))
            progress("tracing", end, len(prepared))
        if parts is not None:
            seen = Stretch.joined(found[-len(stretch) :])
            parts.put(key_of(stretch), FinishedStretch(seen=seen, counted=tally.taken()).packed())
    return joined(found, tally)


def joined(found: Sequence[Stretch], tally: Tally) -> Recording:
    """Return the recording of stretches of a survey, in their order, and of what was counted over them."""
    whole = Stretch.joined(found)
    return Recording(
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


def stretches_of(prepared: Prepared, block_size: int) -> list[list[tuple[int, int]]]:
    """Return the blocks of each stretch of a survey, by their first pulses and their ends."""
    chirps = 1 if prepared.bursts is None else prepared.bursts.chirps
    bounds = list(prepared.flight.line_bounds(max(1, block_size // chirps)))
    count = min(STRETCH_BLOCKS, -(-len(bounds) // MIN_STRETCHES))
    return [bounds[first : first + count] for first in range(0, len(bounds), count)]


def key_of(stretch: Sequence[tuple[int, int]]) -> str:
    """Return the name of a stretch among the parts of its survey."""
    return f"blocks {list(stretch)}"


@on_one_thread
def fly_stretch(prepared: Prepared, sensor: Sensor, stretch: Sequence[tuple[int, int]]) -> FinishedStretch:
    """Return the observations of a sensor over some blocks of a survey, and the true hits over them."""
    tally = Tally(prepared.truth(), prepared.receiver.chirp)
    flying = _Flying(prepared, sensor, tally, Stopwatch(), ())
    blocks = (prepared.flight.pulses(np.arange(*block)) for block in stretch)
    seen = Stretch.joined([flying.counted(block) for block in fly(blocks, sensor)])
    return FinishedStretch(seen=seen, counted=tally.taken())


@dataclass(frozen=True)
class _Flying:
    """Counts what a sensor observes of a survey, and lets recorders keep it."""

    prepared: Prepared
    sensor: Sensor
    tally: Tally
    watch: Stopwatch
    recorders: Sequence[Recorder]

    def counted(self, block: ObservedBlock) -> Stretch:
        """Return the echoes, profiles and counts of a block, after tallying and recording it."""
        pulses, seen = block.pulses, block.observation
        lost = 0
        with self.watch("map"):
            self.tally.add(seen.paths, pulses)
            self.tally.add_silence(seen.paths, pulses, seen.echoes)
        if self.recorders:
            with self.watch("record"):
                for recorder in self.recorders:
                    recorder.write(pulses, seen)
        if seen.through_volume:
            lost = len(pulses) - len(np.unique(seen.echoes.pulse))
        else:
            self.tally.add_echoes(self.sensor.correct(seen.echoes, pulses.index, pulses.measured), seen.paths)
        profiles = seen.profiles if self.prepared.mapper.keeps_profiles else None
        saturated = np.zeros(1, dtype=np.int64) if seen.saturated is None else seen.saturated
        return Stretch(
            echoes=seen.echoes,
            profiles=profiles,
            lost=lost,
            saturated_pulses=int(np.count_nonzero(saturated)),
            saturated_samples=int(saturated.sum()),
        )


def place(echoes: Echoes, sensor: Sensor, schedule: PulseSchedule, *, block_size: int = BLOCK_SIZE) -> Points:
    """Correct and locate echoes by the poses that a schedule's navigation reports."""
    located = []
    for pulses in schedule.blocks(block_size):
        own = echoes.of_pulses(pulses.index)
        corrected = sensor.correct(own, pulses.index, pulses.measured)
        located.append(locate(corrected, pulses.index, pulses.measured))
    return Points.concatenate(located)
