"""Flying a prepared survey: what its sensor observes, block by block, and where that is placed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool

from sionna_radar.accuracy.truth import Comparison, Tally
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.profiles import Profiles
from sionna_radar.flight.pulses import Pulses, PulseSchedule
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.foundation.stopwatch import Stopwatch
from sionna_radar.mapping.points import Points, locate
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.sensors.sensor import Observation, Sensor

BLOCK_SIZE = 256
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


def fly(schedule: PulseSchedule, sensor: Sensor, block_size: int = BLOCK_SIZE) -> Iterator[ObservedBlock]:
    """Yield a survey block by block, as the sensor observes it.

    A sensor with a method `expect` is told of each block before it observes the one in front of it, and may begin with
    it in another thread.
    """
    expect = getattr(sensor, "expect", None)
    blocks = schedule.line_blocks(block_size)
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
    lit: cells of the DEM that the beam reached.
    paths: how many were traced.
    rain_echoes: how many of the echoes hold more of rain than of anything else, where nothing is done about rain.
    lost_to_rain: pulses without an echo because rain masks the ground.
    """

    echoes: Echoes
    profiles: Profiles | None
    lit: Bool[np.ndarray, "row column"]
    paths: int
    rain_echoes: int
    lost_to_rain: int = 0

    @property
    def behind_volume(self) -> bool:
        """Whether its profiles are of ground behind a volume of rain."""
        return self.profiles is not None and self.profiles.volume is not None


@on_one_thread
def record(
    prepared: Prepared,
    sensor: Sensor,
    *,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    watch: Stopwatch | None = None,
    recorders: Sequence[Recorder] = (),
) -> Recording:
    """Fly a prepared survey and return what the sensor observed, block by block; recorders keep more of it."""
    watch = watch or Stopwatch()
    tally = Tally(prepared.truth(), prepared.receiver.chirp)
    keeps_profiles = prepared.mapper.keeps_profiles
    echoes, profiles, lost = [], [], 0
    progress("tracing", 0, len(prepared))
    for block in fly(prepared.flight, sensor, block_size):
        pulses, seen = block.pulses, block.observation
        echoes.append(seen.echoes)
        if keeps_profiles and seen.profiles is not None:
            profiles.append(seen.profiles)
        with watch("map"):
            tally.add(seen.paths, pulses)
        if recorders:
            with watch("record"):
                for recorder in recorders:
                    recorder.write(pulses, seen)
        if seen.through_volume:
            lost += len(pulses) - len(np.unique(seen.echoes.pulse))
        else:
            tally.add_echoes(sensor.correct(seen.echoes, pulses.index, pulses.measured), seen.paths)
        progress("tracing", int(pulses.index[-1]) + 1, len(prepared))
    return Recording(
        echoes=Echoes.concatenate(echoes),
        profiles=Profiles.concatenate(profiles) if profiles else None,
        lit=tally.lit(),
        paths=tally.paths,
        rain_echoes=tally.rain_echoes,
        lost_to_rain=lost,
    )


def place(echoes: Echoes, sensor: Sensor, schedule: PulseSchedule, *, block_size: int = BLOCK_SIZE) -> Points:
    """Correct and locate echoes by the poses that a schedule's navigation reports."""
    located = []
    for pulses in schedule.blocks(block_size):
        own = echoes.of_pulses(pulses.index)
        corrected = sensor.correct(own, pulses.index, pulses.measured)
        located.append(locate(corrected, pulses.index, pulses.measured))
    return Points.concatenate(located)
