"""Pulse schedule of a survey: time and antenna pose of each transmitted chirp, and bursts of averaged chirps.

The chirps of a burst are averaged to one pulse of the survey, in the middle of its chirps.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.flight.frames import Vector3, antenna_place, body_motion, world_from_body, world_from_level
from sionna_radar.flight.scan import Scan
from sionna_radar.flight.trajectory import Flight, Phase, Trajectory
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.raster import Heights, box_around
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.foundation.threads import chunks

CHIRPS_AT_ONCE = 100_000
# A continuous scan is divided into lines of this many pulses, counted from the first of the survey.
LONGEST_LINE = 512


@dataclass(frozen=True, kw_only=True)
class Pose(Columns):
    """Position, velocity and antenna orientation of the radar, in the world frame."""

    position_m: Float[np.ndarray, "pulse 3"]
    velocity_mps: Float[np.ndarray, "pulse 3"]
    R_world_antenna: Float[np.ndarray, "pulse 3 3"]

    @property
    def boresight(self) -> Float[np.ndarray, "pulse 3"]:
        """Unit vectors along the beam."""
        return self.R_world_antenna[:, :, 0]

    @property
    def boresight_range_rate_mps(self) -> Float[np.ndarray, " pulse"]:
        """Range rate of stationary ground on the boresight."""
        return -np.einsum("pi,pi->p", self.velocity_mps, self.boresight)


@runtime_checkable
class Navigation(Protocol):
    """A navigation system: the only source of the motion in processing."""

    def measure(
        self,
        index: Int[np.ndarray, " pulse"],
        time_s: Float[np.ndarray, " pulse"],
        trajectory: Trajectory,
        R_body_antenna: Float[np.ndarray, "pulse 3 3"],
    ) -> Pose:
        """Return the reported pose of the antenna.

        Parameters
        ----------
        index, time_s:
            Indices and times of the pulses.
        trajectory:
            True motion of the navigation system.
        R_body_antenna:
            Antenna in the platform, as measured by the encoders of its scan and its stabilisation.
        """


def antenna_pose(
    trajectory: Trajectory,
    time_s: Float[np.ndarray, " pulse"],
    R_body_antenna: Float[np.ndarray, "pulse 3 3"],
    lever_arm_m: Vector3 = (0.0, 0.0, 0.0),
) -> Pose:
    """Return the true pose of an antenna, to which navigation systems add their errors.

    Parameters
    ----------
    trajectory, time_s:
        Motion of the navigation system, and the times.
    R_body_antenna:
        Antenna in the platform.
    lever_arm_m:
        From the navigation system to the antenna: nose, right, down.

    Returns
    -------
    Positions, velocities and orientations of the antenna in the world frame.
    """
    motion = body_motion(trajectory, time_s)
    position_m, velocity_mps = antenna_place(motion, lever_arm_m)
    return Pose(
        position_m=position_m,
        velocity_mps=velocity_mps,
        R_world_antenna=world_from_body(motion.euler_rad) @ R_body_antenna,
    )


def rows_of(index: Int[np.ndarray, " pulse"], wanted: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Return the rows of pulses, given by their survey indices, in a sorted column of indices."""
    return np.searchsorted(index, wanted)


@dataclass(frozen=True, kw_only=True)
class Pulses(Columns):
    """A block of pulses.

    index: index in the survey, the key of all random numbers.
    time_s: middle of the chirp.
    true: the pose from which paths are traced.
    measured: the pose reported by the navigation system; the only one that processing may use.
    scan_number: scan of the antenna that the pulse belongs to, from 0; None for a continuous scan.
    beam: number of the beam of an electronic scan; None for an antenna whose pattern does not change.
    """

    index: Int[np.ndarray, " pulse"]
    time_s: Float[np.ndarray, " pulse"]
    scan_rad: Float[np.ndarray, " pulse"]
    true: Pose
    measured: Pose
    scan_number: Int[np.ndarray, " pulse"] | None = None
    beam: Int[np.ndarray, " pulse"] | None = None

    def row_of(self, pulse: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Return the rows of the block that hold pulses given by their indices."""
        return rows_of(self.index, pulse)

    @property
    def line(self) -> Int[np.ndarray, " pulse"]:
        """Scan line of each pulse within the block; long ones are divided at the same pulses in all blocks."""
        return np.cumsum(np.concatenate([[False], ends_of_lines(self.index, self.scan_number)]))


class PulseSequence(ABC):
    """All pulses of a survey, block by block."""

    @property
    @abstractmethod
    def scan_numbers(self) -> Int[np.ndarray, " pulse"] | None:
        """Scan of the antenna that each pulse belongs to; None for a continuous scan."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def pulses(self, index: Int[np.ndarray, " pulse"]) -> Pulses:
        """Return some of the pulses."""

    def blocks(self, block_size: int) -> Iterator[Pulses]:
        """Yield the pulses in blocks of at most `block_size`."""
        for start in range(0, len(self), block_size):
            yield self.pulses(np.arange(start, min(start + block_size, len(self))))

    def line_blocks(self, block_size: int) -> Iterator[Pulses]:
        """Yield the pulses in blocks of whole scan lines; see `line_bounds`."""
        for start, end in self.line_bounds(block_size):
            yield self.pulses(np.arange(start, end))

    def line_bounds(self, block_size: int) -> Iterator[tuple[int, int]]:
        """Yield first pulse and end of blocks of whole scan lines: as many as fit into `block_size`, at least one."""
        ends = self._line_ends()
        start = 0
        while start < len(self):
            fitting = ends[(ends > start) & (ends <= start + block_size)]
            end = int(fitting[-1] if len(fitting) else ends[ends > start][0])
            yield start, end
            start = end

    def lines_of(self, index: Int[np.ndarray, " pulse"]) -> list[Int[np.ndarray, " _"]]:
        """Return the pulses of each scan line that holds some of the pulses."""
        ends = self._line_ends()
        starts = np.append(0, ends[:-1])
        return [np.arange(starts[line], ends[line]) for line in np.unique(np.searchsorted(ends, index, side="right"))]

    def _line_ends(self) -> Int[np.ndarray, " line"]:
        """Return the end of each scan line: the number of its last pulse and 1."""
        return np.append(np.flatnonzero(ends_of_lines(np.arange(len(self)), self.scan_numbers)) + 1, len(self))

    def sample(self, count: int) -> Pulses:
        """Return `count` pulses (or all) spread over the survey and over the angles of its scan."""
        return self.pulses(spread_indices(count, len(self)))


@dataclass(frozen=True, kw_only=True)
class PulseSchedule(PulseSequence):
    """All pulses of a survey by their times; poses are computed block by block.

    trajectory: motion of the platform at its navigation system.
    lever_arm_m: from there to the antenna, nose-right-down.
    navigation: reports the measured pose; None for the true one.
    """

    trajectory: Trajectory
    scan: Scan
    time_s: Float[np.ndarray, " pulse"]
    lever_arm_m: Vector3 = (0.0, 0.0, 0.0)
    navigation: Navigation | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    def pulses(self, index: Int[np.ndarray, " pulse"]) -> Pulses:
        """Return some of the pulses."""
        return self.at(index, self.time_s[index])

    def mount(
        self, time_s: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
        """Return the true position and velocity of the antenna at any times, and the orientation of its mount."""
        euler = self.trajectory.euler(time_s)
        R_world_mount = world_from_level(euler) if self.scan.stabilised else world_from_body(euler)
        return *antenna_place(body_motion(self.trajectory, time_s), self.lever_arm_m), R_world_mount

    def at(self, index: Int[np.ndarray, " pulse"], time_s: Float[np.ndarray, " pulse"]) -> Pulses:
        """Return pulses at any times; `index` is the key of their random numbers."""
        pointing = self.scan.point(time_s)
        position, velocity, R_world_mount = self.mount(time_s)
        true_pose = Pose(
            position_m=position, velocity_mps=velocity, R_world_antenna=R_world_mount @ pointing.R_mount_antenna
        )
        measured_pose = true_pose
        if self.navigation is not None:
            stabilised = self.scan.stabilised
            R_world_body = world_from_body(self.trajectory.euler(time_s)) if stabilised else R_world_mount
            R_body_antenna = R_world_body.transpose(0, 2, 1) @ true_pose.R_world_antenna
            measured_pose = self.navigation.measure(index, time_s, self.trajectory, R_body_antenna)
        return Pulses(
            index=index,
            time_s=time_s,
            scan_rad=pointing.scan_rad,
            true=true_pose,
            measured=measured_pose,
            scan_number=pointing.scan_number,
            beam=pointing.beam,
        )

    @property
    def scan_numbers(self) -> Int[np.ndarray, " pulse"] | None:
        """Scan of the antenna that each pulse belongs to; None for a continuous scan."""
        chunks = [self.scan.point(chunk).scan_number for chunk in np.array_split(self.time_s, 1 + len(self) // 65_536)]
        scan_numbers = [chunk for chunk in chunks if chunk is not None]
        return np.concatenate(scan_numbers) if scan_numbers else None


def ends_of_lines(
    index: Int[np.ndarray, " pulse"], scan_number: Int[np.ndarray, " pulse"] | None
) -> Bool[np.ndarray, " step"]:
    """Return the mask of pulses (except the last) that end a scan line."""
    ends: Bool[np.ndarray, " step"] = np.diff(index // LONGEST_LINE) != 0
    return ends if scan_number is None else ends | (np.diff(scan_number) != 0)


def chirp_times_s(
    chirp: Int[np.ndarray, " chirp"], start_s: float, rate_hz: float, stagger: float = 0.0
) -> Float[np.ndarray, " chirp"]:
    """Return the middle times of chirps by their numbers; chirp 0 starts at `start_s`. See `schedule_pulses`."""
    time_s = start_s + (chirp + 0.5) / rate_hz
    return time_s + chirp // 2 * (stagger / rate_hz) if stagger > 0 else time_s


def schedule_pulses(
    trajectory: Trajectory,
    scan: Scan,
    chirp_rate_hz: float,
    *,
    lever_arm_m: Vector3 = (0.0, 0.0, 0.0),
    navigation: Navigation | None = None,
    stagger: float = 0.0,
) -> PulseSchedule:
    """Return the pulses of the cruise at the chirp rate, without those outside the scan sector.

    A trajectory may restrict transmission to parts of the cruise. `stagger` is the extra pause after every second
    chirp, relative to a chirp's duration.
    """
    start, end = trajectory.cruise_s()
    count = int(np.floor((end - start) * chirp_rate_hz + 1e-9))
    edges = None if trajectory.transmits_s is None else np.array(trajectory.transmits_s).ravel()
    kept = [np.zeros(0)]
    for low, high in chunks(count, CHIRPS_AT_ONCE):
        time_s = chirp_times_s(np.arange(low, high), start, chirp_rate_hz, stagger)
        if stagger > 0:
            time_s = time_s[time_s <= end - 0.5 / chirp_rate_hz]
        active = scan.point(time_s).active
        if edges is not None:
            active = active & (np.searchsorted(edges, time_s, side="right") % 2 == 1)
        kept.append(time_s[active])
    return PulseSchedule(
        trajectory=trajectory,
        scan=scan,
        time_s=np.concatenate(kept),
        lever_arm_m=lever_arm_m,
        navigation=navigation,
    )


@dataclass(frozen=True, kw_only=True)
class MeasuredPoseSchedule(PulseSchedule):
    """A schedule of pulses whose poses are known, instead of computed from a trajectory."""

    poses: Pulses

    def at(self, index: Int[np.ndarray, " pulse"], time_s: Float[np.ndarray, " pulse"]) -> Pulses:
        """Return pulses by their numbers; their times are known."""
        del time_s
        return replace(self.poses.rows(index), index=index)

    @property
    def scan_numbers(self) -> Int[np.ndarray, " pulse"] | None:
        """Scan of the antenna that each pulse belongs to; None for a continuous scan."""
        return self.poses.scan_number


@dataclass(frozen=True, kw_only=True)
class MeasuredPoseFlight:
    """The pulses of a recorded flight in the metres of a scenario, before its ground is known; a `Route`.

    pulses: all of them; their heights are those of the map, or local ones where the ground has no place on it.
    nominal_m: nominal height above ground; None for the median of the flight.
    """

    pulses: Pulses
    nominal_m: float | None = None
    altitude_m: float | None = None

    @property
    def _track_m(self) -> Float[np.ndarray, "pulse 3"]:
        return self.pulses.measured.position_m

    @property
    def duration_s(self) -> float:
        """Time from the first pulse to the last."""
        return float(np.ptp(self.pulses.time_s))

    @property
    def length_m(self) -> float:
        """Length of the track."""
        return float(np.linalg.norm(np.diff(self._track_m[:, :2], axis=0), axis=1).sum())

    @property
    def speed_mps(self) -> float:
        """Median speed over the ground."""
        return max(float(np.median(np.hypot(*self.pulses.measured.velocity_mps[:, :2].T))), 1e-3)

    def window_m(self, reach_m: float) -> tuple[float, float, float, float]:
        """Return the extent within a reach of it: west, south, east, north."""
        return box_around(self._track_m[:, :2], reach_m)

    def fly(self, ground_m: Heights, seed: int, origin_height_m: float = 0.0) -> Flight:
        """Return the flight over ground of given heights."""
        del seed  # nothing of it is random
        time_s, track_m = self.pulses.time_s, self._track_m - [0.0, 0.0, origin_height_m]
        clearance_m = track_m[:, 2] - ground_m(track_m[:, :2])

        def along(values: Float[np.ndarray, "pulse 3"]) -> Callable[[Float[np.ndarray, " n"]], np.ndarray]:
            return lambda at_s: np.column_stack([np.interp(at_s, time_s, column) for column in values.T])

        track, velocity = along(track_m), along(self.pulses.measured.velocity_mps)

        def position(at_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
            beyond_s = at_s - np.clip(at_s, time_s[0], time_s[-1])
            return track(at_s) + beyond_s[:, None] * velocity(at_s)

        def level(at_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
            east, north, _ = velocity(at_s).T
            return np.column_stack([np.zeros((len(at_s), 2)), np.arctan2(east, north)])

        trajectory = Trajectory(
            position=position,
            velocity=velocity,
            euler=level,
            phases=((Phase.CRUISE, float(time_s[0]), float(time_s[-1])),),
        )
        over_ground_m = clearance_m[np.isfinite(clearance_m)]
        altitude_m = self.nominal_m or (float(np.median(over_ground_m)) if len(over_ground_m) else 1.0)
        return Flight(trajectory=trajectory, altitude_m=max(altitude_m, 1e-3), speed_mps=self.speed_mps)

    def schedule(
        self,
        flown: Flight,
        scan: Scan,
        origin_height_m: float,
        navigation: Navigation | None = None,
        lever_arm_m: Vector3 = (0.0, 0.0, 0.0),
    ) -> MeasuredPoseSchedule:
        """Return its pulses, with heights over the local origin.

        The measured poses are the given ones. The true ones are those of which the navigation system reports them, to
        first order in its errors, on a platform that flies level along its track; without one they are the same.
        """
        pulses, pose, trajectory = self.pulses, self.pulses.measured, flown.trajectory
        true = local = replace(pose, position_m=pose.position_m - [0.0, 0.0, origin_height_m])
        if navigation is not None:
            R_world_body = world_from_body(trajectory.euler(pulses.time_s))
            R_body_antenna = R_world_body.transpose(0, 2, 1) @ pose.R_world_antenna
            reported = navigation.measure(pulses.index, pulses.time_s, trajectory, R_body_antenna)
            flown_m = antenna_pose(trajectory, pulses.time_s, R_body_antenna, lever_arm_m)
            true = Pose(
                position_m=local.position_m + flown_m.position_m - reported.position_m,
                velocity_mps=local.velocity_mps + flown_m.velocity_mps - reported.velocity_mps,
                R_world_antenna=pose.R_world_antenna
                @ reported.R_world_antenna.transpose(0, 2, 1)
                @ pose.R_world_antenna,
            )
        poses = replace(pulses, true=true, measured=local)
        return MeasuredPoseSchedule(trajectory=trajectory, scan=scan, time_s=pulses.time_s, poses=poses)


# Interval between chirps, in periods, above which the scan has paused.
PAUSE_PERIODS = 1.5


@dataclass(frozen=True, kw_only=True)
class Bursts:
    """The chirps of the pulses of a schedule.

    schedule: of the pulses. chirps: number per pulse. period_s: chirp repetition interval.
    """

    schedule: PulseSchedule
    chirps: int
    period_s: float

    @property
    def offset_s(self) -> Float[np.ndarray, " chirp"]:
        """Time of each chirp from the middle of its burst."""
        return (np.arange(self.chirps) - (self.chirps - 1) / 2) * self.period_s

    def chirps_of(self, pulses: Pulses) -> Pulses:
        """Return the chirps of pulses, each with a unique index: the key of its random numbers.

        The motion is measured once per burst.
        """
        index = (pulses.index[:, None] * self.chirps + np.arange(self.chirps)).ravel()
        time_s = (pulses.time_s[:, None] + self.offset_s).ravel()
        chirps = self.schedule.at(index, time_s)
        return replace(chirps, measured=pulses.measured.rows(np.repeat(np.arange(len(pulses)), self.chirps)))


def in_bursts(schedule: PulseSchedule, chirps: int, rate_hz: float) -> Bursts | None:
    """Group a schedule's chirps into bursts of consecutive chirps of one scan; incomplete bursts are not sent.

    None for bursts of a single chirp.

    schedule: of single chirps.
    chirps: number per burst.
    rate_hz: chirp rate.
    """
    if chirps == 1:
        return None
    time_s, scan_number = schedule.time_s, schedule.scan_numbers
    if len(time_s) == 0:
        return Bursts(schedule=schedule, chirps=chirps, period_s=1 / rate_hz)
    middle_s, _ = burst_middles_s(time_s, scan_number, chirps, rate_hz)
    return Bursts(schedule=replace(schedule, time_s=middle_s), chirps=chirps, period_s=1 / rate_hz)


def burst_middles_s(
    time_s: Float[np.ndarray, " chirp"], scan_number: Int[np.ndarray, " chirp"] | None, chirps: int, rate_hz: float
) -> tuple[Float[np.ndarray, " burst"], int]:
    """Return the middle times of bursts of successive chirps of one scan, and how many chirps are left at the end."""
    breaks = np.diff(time_s) > PAUSE_PERIODS / rate_hz
    if scan_number is not None:
        breaks |= np.diff(scan_number) != 0
    run_starts = np.concatenate([[0], np.flatnonzero(breaks) + 1])
    run_length = np.diff(np.append(run_starts, len(time_s)))
    index_in_run = np.arange(len(time_s)) - np.repeat(run_starts, run_length)
    complete = index_in_run < np.repeat(run_length - run_length % chirps, run_length)
    return time_s[complete].reshape(-1, chirps).mean(axis=1), int(run_length[-1] % chirps)
