"""Trajectories of straight legs with constant acceleration, level or terrain-following.

The track is a horizontal polyline, cruised at one speed; a turn at a waypoint is instantaneous (arcs and banks are in
`turns`), and so are the cruise's start and end. Phases: take-off and landing (vertical, near the ground), climb and
descent (vertical, to and from the cruise height), cruise (along the track).

`Flight` is a flight over its ground, planned or recorded.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import CubicSpline, PPoly

from sionna_radar.foundation.raster import Heights


class Phase(StrEnum):
    """A phase of a flight."""

    TAKE_OFF = "take-off"
    CLIMB = "climb"
    CRUISE = "cruise"
    DESCENT = "descent"
    LANDING = "landing"


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """A flight: position and velocity in the world frame and Euler angles (roll, pitch, heading).

    transmits_s: intervals in which the radar transmits; None for the whole cruise.
    logged_sigma: standard deviations stated by a log: position (m), velocity (m/s) and attitude (rad; roll, pitch,
    heading) by three axes each, NaN where unknown; None for a flight without them.
    turn: turn rate about nose, right and down, rad/s; None where it follows from the attitudes.
    """

    position: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, "n 3"]]
    velocity: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, "n 3"]]
    euler: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, "n 3"]]
    phases: tuple[tuple[Phase, float, float], ...]
    transmits_s: tuple[tuple[float, float], ...] | None = None
    logged_sigma: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, "n 3 3"]] | None = None
    turn: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, "n 3"]] | None = None

    @property
    def end_s(self) -> float:
        """End time of the last phase; the flight starts at zero."""
        return self.phases[-1][2]

    def cruise_s(self) -> tuple[float, float]:
        """Return the start and end of the cruise."""
        return next((start, end) for phase, start, end in self.phases if phase is Phase.CRUISE)


@runtime_checkable
class Course(Protocol):
    """A horizontal track, by the distance along it.

    waypoints_m: its first and last point, and points in between that cover its extent.
    """

    @property
    def waypoints_m(self) -> Float[np.ndarray, "k 2"]:
        """See the class."""

    @property
    def length_m(self) -> float:
        """Length of the track."""

    def point(self, distance_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Return the points at distances along the track."""

    def direction(self, distance_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Return the unit vectors along the track."""


@dataclass(frozen=True)
class Track:
    """A horizontal polyline, by the distance along it."""

    waypoints_m: Float[np.ndarray, "k 2"]

    @property
    def leg_lengths_m(self) -> Float[np.ndarray, " leg"]:
        """Length of each leg."""
        return np.linalg.norm(np.diff(self.waypoints_m, axis=0), axis=1)

    @property
    def length_m(self) -> float:
        """Length of all legs."""
        return float(self.leg_lengths_m.sum())

    def _leg(self, distance_m: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        ends = np.cumsum(self.leg_lengths_m)
        return np.minimum(np.searchsorted(ends, distance_m, side="right"), len(ends) - 1)

    def point(self, distance_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Return the points at distances along the track."""
        leg = self._leg(distance_m)
        start = np.concatenate([[0.0], np.cumsum(self.leg_lengths_m)])[leg]
        return self.waypoints_m[leg] + (distance_m - start)[:, None] * self.direction(distance_m)

    def direction(self, distance_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Return the unit vectors along the legs at distances along the track."""
        leg = self._leg(distance_m)
        return (np.diff(self.waypoints_m, axis=0) / self.leg_lengths_m[:, None])[leg]


@dataclass(frozen=True, kw_only=True)
class FlightPlan:
    """Heights and speeds of a planned flight.

    altitude_m: height above the ground under the start, or, following the terrain, under the track.
    follow_length_m: length over which the followed ground is smoothed.
    response_s: time constant tau with which the flight follows the height h that it senses above the ground below,
        instead of ground known ahead: tau dz/dt = altitude_m - h. None: it follows smoothed ground without a lag.
    vertical: whether it has take-off, climb, descent and landing, with these rates.
    takeoff_height_m: height above the ground where the take-off ends and the climb begins.
    wheels_m: distances between the axles and between the wheels of a vehicle on the ground; None in the air.
    """

    altitude_m: float
    speed_mps: float
    follows_terrain: bool = False
    follow_length_m: float = 50.0
    response_s: float | None = None
    vertical: bool = False
    climb_rate_mps: float = 2.0
    descent_rate_mps: float = 2.0
    acceleration_mps2: float = 2.0
    takeoff_height_m: float = 5.0
    wheels_m: tuple[float, float] | None = None


def plan_trajectory(plan: FlightPlan, track: Course, ground_m: Heights) -> Trajectory:
    """Plan the flight along a track.

    plan: heights and speeds.
    track: track of the cruise.
    ground_m: ground height at horizontal positions [n, 2]; read under the start, or all along if the flight follows the
        terrain.
    """
    start_ground = float(ground_m(track.waypoints_m[:1])[0])
    height = _cruise_height(plan, track, ground_m, start_ground)
    if not plan.vertical:
        before, after = [], []
    else:
        before = _vertical_phases(plan, start_ground, float(height(np.zeros(1))[0]))
        end_ground = float(ground_m(track.waypoints_m[-1:])[0])
        end_height = float(height(np.array([track.length_m]))[0])
        after = _mirrored(_vertical_phases(plan, end_ground, end_height, landing=True))
    legs = _Legs(
        track=track,
        speed_mps=plan.speed_mps,
        cruise_height=height,
        before=tuple(before),
        cruise_duration_s=track.length_m / plan.speed_mps,
        after=tuple(after),
    )
    return Trajectory(position=legs.position, velocity=legs.velocity, euler=legs.euler, phases=legs.phases)


@dataclass(frozen=True)
class _VerticalPhase:
    """A vertical movement: height against time since the phase began."""

    phase: Phase
    duration_s: float
    height: PPoly


@dataclass(frozen=True, kw_only=True)
class _Legs:
    """The whole flight: vertical phases, the cruise along the track, vertical phases."""

    track: Course
    speed_mps: float
    cruise_height: PPoly
    before: tuple[_VerticalPhase, ...]
    cruise_duration_s: float
    after: tuple[_VerticalPhase, ...]

    @cached_property
    def phases(self) -> tuple[tuple[Phase, float, float], ...]:
        """Each phase with its start and end."""
        durations = [
            *((p.phase, p.duration_s) for p in self.before),
            (Phase.CRUISE, self.cruise_duration_s),
            *((p.phase, p.duration_s) for p in self.after),
        ]
        ends = np.cumsum([duration for _, duration in durations])
        starts = np.concatenate([[0.0], ends[:-1]])
        return tuple(
            (phase, float(start), float(end)) for (phase, _), start, end in zip(durations, starts, ends, strict=True)
        )

    def position(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return positions in the world frame."""
        distance = self._along(time_s)
        height = self.cruise_height(distance)
        for phase, in_phase, since_s in self._vertical(time_s):
            height[in_phase] = phase.height(since_s)
        return np.column_stack([self.track.point(distance), height])

    def velocity(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return velocities in the world frame."""
        distance = self._along(time_s)
        cruising = self._phase_of(time_s) == len(self.before)
        horizontal = self.track.direction(distance) * (self.speed_mps * cruising)[:, None]
        vertical = self.cruise_height.derivative()(distance) * self.speed_mps * cruising
        for phase, in_phase, since_s in self._vertical(time_s):
            vertical[in_phase] = phase.height.derivative()(since_s)
        return np.column_stack([horizontal, vertical])

    def euler(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return roll, pitch and heading."""
        east, north = self.track.direction(self._along(time_s)).T
        heading = np.arctan2(east, north)
        return np.column_stack([np.zeros_like(heading), np.zeros_like(heading), heading])

    def _phase_of(self, time_s: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        ends = [end for _, _, end in self.phases]
        return np.minimum(np.searchsorted(ends, time_s, side="right"), len(ends) - 1)

    def _along(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return distances along the track."""
        _, start, _ = self.phases[len(self.before)]
        return np.clip((time_s - start) * self.speed_mps, 0.0, self.track.length_m)

    def _vertical(
        self, time_s: Float[np.ndarray, " n"]
    ) -> Iterator[tuple[_VerticalPhase, Bool[np.ndarray, " n"], Float[np.ndarray, " inside"]]]:
        """Yield each vertical phase, the times within it, and the same relative to its start."""
        phase_index = self._phase_of(time_s)
        for index, phase in enumerate((*self.before, None, *self.after)):
            if phase is not None:
                in_phase = phase_index == index
                yield phase, in_phase, time_s[in_phase] - self.phases[index][1]


def _cruise_height(plan: FlightPlan, track: Course, ground_m: Callable, start_ground: float) -> PPoly:
    """Return the height of the cruise against the distance along the track."""
    if not plan.follows_terrain:
        level = start_ground + plan.altitude_m
        return PPoly(np.array([[0.0], [level]]), [0.0, max(track.length_m, 1.0)])
    # The ground is averaged over follow_length_m, as by a flight controller, then splined. Toward the ends of the
    # track the average narrows and stays centred: a one-sided one would be biased on a slope.
    window = plan.follow_length_m if plan.response_s is None else plan.response_s * plan.speed_mps / 10
    step = window / 10 if plan.response_s is None else window
    distance = np.linspace(0.0, track.length_m, max(int(np.ceil(track.length_m / step)) + 1, 5))
    half_window = np.minimum(window / 2, np.minimum(distance, track.length_m - distance))
    samples = distance[:, None] + half_window[:, None] * np.linspace(-1.0, 1.0, 11)
    height = ground_m(track.point(samples.ravel())).reshape(samples.shape).mean(axis=1) + plan.altitude_m
    if plan.response_s is not None:
        from scipy.signal import lsim

        first_order = ([1.0], [plan.response_s * plan.speed_mps, 1.0])
        height = height[0] + lsim(first_order, height - height[0], distance)[1]
    return CubicSpline(distance, height)


def _vertical_phases(plan: FlightPlan, ground: float, height: float, *, landing: bool = False) -> list[_VerticalPhase]:
    """Return take-off and climb, each from rest to rest with a trapezoidal profile of vertical speed."""
    rate = plan.descent_rate_mps if landing else plan.climb_rate_mps
    names = (Phase.LANDING, Phase.DESCENT) if landing else (Phase.TAKE_OFF, Phase.CLIMB)
    low = ground + plan.takeoff_height_m
    return [
        _trapezoid(names[0], ground, low, rate, plan.acceleration_mps2),
        _trapezoid(names[1], low, height, rate, plan.acceleration_mps2),
    ]


def _trapezoid(phase: Phase, start: float, end: float, rate: float, acceleration: float) -> _VerticalPhase:
    distance = end - start
    rate = min(rate, np.sqrt(abs(distance) * acceleration))
    ramp = rate / acceleration
    hold = abs(distance) / rate - ramp
    times = np.cumsum([0.0, ramp, max(hold, 1e-9), ramp])
    speeds = np.sign(distance) * np.array([0.0, rate, rate, 0.0])
    slopes = np.diff(speeds) / np.diff(times)
    velocity = PPoly(np.array([slopes, speeds[:-1]]), times)
    height = velocity.antiderivative()
    height.c[-1] += start
    return _VerticalPhase(phase, float(times[-1]), height)


def _mirrored(phases: Sequence[_VerticalPhase]) -> list[_VerticalPhase]:
    """Return the phases flown backward in time: a climb becomes a descent."""
    mirrored = []
    for p in reversed(phases):
        times = p.duration_s - p.height.x[::-1]
        velocity_at_knots = -p.height.derivative()(p.height.x[::-1])
        slopes = np.diff(velocity_at_knots) / np.diff(times)
        height = PPoly(np.array([slopes, velocity_at_knots[:-1]]), times).antiderivative()
        height.c[-1] += float(p.height(p.duration_s))
        mirrored.append(_VerticalPhase(p.phase, p.duration_s, height))
    return mirrored


@dataclass(frozen=True, kw_only=True)
class Flight:
    """A flight over its ground.

    altitude_m, speed_mps: nominal height above ground and ground speed, used for sampling and reference levels.
    record: data of its log, in plain tables; None for a planned flight.
    warnings: caveats about its results.
    """

    trajectory: Trajectory
    altitude_m: float
    speed_mps: float
    record: dict[str, Any] | None = None
    warnings: tuple[str, ...] = ()
