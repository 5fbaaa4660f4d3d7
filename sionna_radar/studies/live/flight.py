"""A live flight: frames from a planned flight, a recording or an autopilot, to a map and to who listens."""

import logging
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from sionna_radar.flight.frames import body_motion
from sionna_radar.foundation.errors import InputFileError, PoseError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.interrupts import raise_received, until_interrupted
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.mapper import Mapper
from sionna_radar.scenario import Scenario
from sionna_radar.studies.live.frame import Frame, listen
from sionna_radar.studies.live.live_map import LiveMap
from sionna_radar.studies.live.mavlink import MavlinkVehicle
from sionna_radar.studies.live.radar import Radar
from sionna_radar.survey.recording_source import open_recording
from sionna_radar.survey.recordings.described import is_recording
from sionna_radar.survey.sensors.sensor import loop_of

logger = logging.getLogger("sionna_radar")

# Steps a second of a flight that is not driven from outside.
STEP_RATE_HZ = 20.0
# Longest wait for a message at once, and interval between lines of status, s.
WAIT_S, STATUS_S = 0.2, 1.0


@runtime_checkable
class Listener(Protocol):
    """Takes each frame as it comes, such as a recorder of messages."""

    def take(self, frame: Frame) -> None:
        """Take a frame."""
        ...


@dataclass(frozen=True, kw_only=True)
class LiveFlight:
    """The record of a live flight.

    source: name of the scenario or recording.
    frames, pulses, echoes: their numbers.
    flown_s, wall_s: time of the flight, from its first pulse to its last step, and time that passed here.
    lag_s: from the time at which each frame was due until it had been dealt with, the 50th, 95th and 100th percentile;
        None for a flight as fast as it goes.
    notices: how often each was given, numbers in it aside; messages: those of the autopilot, by kind and fault.
    dem, sigma: the map; None without one.
    """

    source: str
    frames: int
    pulses: int
    echoes: int
    flown_s: float
    wall_s: float
    lag_s: tuple[float, float, float] | None
    notices: Mapping[str, int]
    messages: Mapping[str, int]
    dem: Raster | None
    sigma: Raster | None


@dataclass(frozen=True)
class Source:
    """Frames in order, and the mapper of their echoes.

    mapper: None where no map can be made.
    flush: returns a frame of what waits for the end of its scan line, at the end; None where nothing waits.
    """

    name: str
    frames: Iterator[Frame]
    mapper: Mapper | None
    flush: Callable[[], Frame] | None = None


@contextmanager
def open_source(
    subject: str, overrides: dict[str, object], load: Callable[[], Scenario]
) -> Iterator[tuple[Source, Radar | None]]:
    """Open a scenario, or a recording with poses for replay; raises ScenarioError and InputFileError for others."""
    path = Path(subject)
    if is_recording(path):
        with open_recording(path, overrides) as recording:
            flight, sensor = recording.flight, recording.build_sensor()
            if not flight.located:
                raise InputFileError(f"{shown(path)} has no poses, which a live map needs; add them to the recording")
            _warn_of_reported_poses(recording.settings.processing.navigation)
            mapper = recording.mapper_of(None) if recording.file.flight is not None else None
            loop = loop_of(sensor)

            def frames() -> Iterator[Frame]:
                """Yield the frames of the recorded pulses, whole scan lines each."""
                pulses_a_step = max(1, round(len(flight) / max(float(np.ptp(flight.time_s)) * STEP_RATE_HZ, 1.0)))
                for pulses in flight.line_blocks(pulses_a_step):
                    yield listen(
                        sensor,
                        float(pulses.time_s[-1]),
                        [pulses],
                        pulses.rows(slice(0, 0)),
                        loop=loop,
                        keep_profiles=recording.keeps_profiles,
                    )

            yield Source(path.stem, frames(), mapper), None
        return
    radar = Radar(load())
    _warn_of_reported_poses(radar.prepared.local.processing.navigation)
    yield Source(path.stem, planned_frames(radar), radar.mapper, radar.flush), radar


def _warn_of_reported_poses(navigation: str) -> None:
    if navigation == "refined":
        logger.warning(
            "processing.navigation = 'refined' takes a whole flight: the live map is of reported poses; for a "
            "refined one, use `sionna-radar run` or `process`"
        )


def planned_frames(radar: Radar) -> Iterator[Frame]:
    """Step a radar along its scenario's own flight, at the poses of its pulses."""
    flight = radar.prepared.flight
    step = np.floor((flight.time_s - flight.time_s[0]) * STEP_RATE_HZ)
    for rows in np.split(np.arange(len(flight)), np.flatnonzero(np.diff(step)) + 1):
        pulses = flight.pulses(rows)
        motion = body_motion(flight.trajectory, pulses.time_s)
        yield radar.step(
            pulses.time_s, motion.position_m, motion.euler_rad, motion.velocity_mps, turn_rad_s=motion.turn_rad_s
        )


def flown_frames(radar: Radar, vehicle: MavlinkVehicle, *, flown_s: float, silent_s: float) -> Iterator[Frame]:
    """Step a radar by the poses of an autopilot, and answer it; end after a time of flight, or of silence."""
    first_s, heard_at_s = None, time.monotonic()
    while True:
        raise_received()
        poses = vehicle.wait(WAIT_S)
        if poses is None:
            if time.monotonic() - heard_at_s > silent_s:
                return
            continue
        heard_at_s = time.monotonic()
        first_s = float(poses.time_s[0]) if first_s is None else first_s
        try:
            frame = radar.step(
                poses.time_s, poses.position_m, poses.euler_rad, poses.velocity_mps, turn_rad_s=poses.turn_rad_s
            )
        except PoseError:
            vehicle.counts["without a usable pose"] += 1
            continue
        vehicle.send(frame)
        yield frame
        if poses.time_s[-1] - first_s >= flown_s:
            return


def fly_live(
    source: Source,
    *,
    speed: float | None = None,
    vehicle: MavlinkVehicle | None = None,
    listeners: tuple[Listener, ...] = (),
    status: Callable[[str], None] = lambda _: None,
) -> LiveFlight:
    """Fly: take each frame to the map and to all listeners, until the source ends or an interrupt comes.

    source: frames and their mapper.
    speed: seconds of the flight that pass in one here; None for as fast as it goes. Meaningless with a vehicle.
    vehicle: the autopilot that drives the source; its faults are counted.
    status: takes a line of status each second.
    """
    live_map = None if source.mapper is None else LiveMap(source.mapper)
    counts, notices, lags = Counter[str](), dict[str, list[Any]](), list[float]()
    began_s = said_s = time.monotonic()
    first_s = last_s = None

    def take(frame: Frame) -> None:
        """Pass a frame to the map and the listeners, and count it."""
        if live_map is not None:
            live_map.add(frame)
        for listener in listeners:
            listener.take(frame)
        counts.update(frames=1, pulses=len(frame), echoes=len(frame.echoes))
        if frame.notice:
            # Of notices that differ in their numbers the first is told, and how many there were.
            notices.setdefault(re.sub(r"[\d.]+", "#", frame.notice), [frame.notice, 0])[1] += 1

    with until_interrupted():
        for frame in source.frames:
            if len(frame):
                last_s = frame.time_s
                # A frame is due at its end; the flight began with its first pulse.
                first_s = float(frame.pulses.time_s[0]) if first_s is None else first_s
            due_s = None
            if speed is not None and last_s is not None and first_s is not None:
                due_s = began_s + (last_s - first_s) / speed
                time.sleep(max(due_s - time.monotonic(), 0.0))
            take(frame)
            now_s = time.monotonic()
            if (due_s := due_s if vehicle is None else vehicle.came_s) is not None:
                lags.append(now_s - due_s)
            if now_s - said_s >= STATUS_S:
                said_s = now_s
                lag = f", lag {lags[-1] * 1e3:.0f} ms" if lags else ""
                status(f"{last_s or 0.0:.1f} s{lag}, {counts['pulses']:,} pulses, {counts['echoes']:,} echoes")
            raise_received()
    if source.flush is not None and len(waited := source.flush()):
        take(waited)
    lag_s = np.percentile(lags, [50, 95, 100]).tolist() if lags else None
    return LiveFlight(
        source=source.name,
        **{name: counts[name] for name in ("frames", "pulses", "echoes")},
        flown_s=0.0 if last_s is None or first_s is None else last_s - first_s,
        wall_s=time.monotonic() - began_s,
        lag_s=None if lag_s is None else tuple(lag_s),
        notices=dict(notices.values()),
        messages={} if vehicle is None else dict(vehicle.counts),
        dem=None if live_map is None else live_map.dem(),
        sigma=None if live_map is None else live_map.sigma(),
    )
