"""Tracks with turns: straight legs and circular arcs, parameterised by distance, and the bank in the arcs.

In a coordinated turn at speed v the radius r and the bank satisfy tan(bank) = v^2 / (g r). The bank changes at a
steady rate while the aircraft rolls in and out, half of it before and half of it after the arc begins or ends; the arc
itself is a circle from its start (an aircraft's own would be a clothoid, which differs by v^2 t^2 / (24 r) m
for a roll-in of t, 0.2 m at 10 m/s, 1 s and 20 m).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.constants import g as gravity

from sionna_radar.flight.trajectory import Trajectory
from sionna_radar.foundation.errors import ScenarioError

# A turn back on itself has no arc between its legs.
MAX_TURN_RAD = np.deg2rad(175.0)
MIN_TURN_RAD = 1e-9


@dataclass(frozen=True, kw_only=True)
class TurnSegment:
    """A straight leg or an arc: start, heading there (clockwise from north), curvature and length.

    curvature_per_m: heading change, rad/m; positive to the right. on_line: whether it is surveyed.
    """

    start_m: tuple[float, float]
    heading_rad: float
    length_m: float
    curvature_per_m: float = 0.0
    on_line: bool = True

    @property
    def end(self) -> tuple[float, float, float]:
        """East, north and heading at its end."""
        east, north = _along(np.array([self.length_m]), self)[0]
        return float(east), float(north), self.heading_rad + self.curvature_per_m * self.length_m


def _along(distance_m: Float[np.ndarray, " n"], segment: TurnSegment) -> Float[np.ndarray, "n 2"]:
    """Return points of a segment: the integral of (sin, cos) of the heading."""
    half_turn = segment.curvature_per_m * distance_m / 2
    chord = distance_m * np.sinc(half_turn / np.pi)
    heading = segment.heading_rad + half_turn
    return np.array(segment.start_m) + chord[:, None] * np.column_stack([np.sin(heading), np.cos(heading)])


@dataclass(frozen=True, kw_only=True)
class CurvedTrack:
    """Segments one after the other; a `Course`."""

    segments: tuple[TurnSegment, ...]

    @cached_property
    def _starts_m(self) -> Float[np.ndarray, " leg"]:
        return np.concatenate([[0.0], np.cumsum([segment.length_m for segment in self.segments])])

    @property
    def length_m(self) -> float:
        """Length of all segments."""
        return float(self._starts_m[-1])

    @cached_property
    def waypoints_m(self) -> Float[np.ndarray, "k 2"]:
        """Points along the track, dense enough to cover its extent."""
        distance_m = np.concatenate(
            [np.linspace(a, b, 9) for a, b in zip(self._starts_m[:-1], self._starts_m[1:], strict=True)]
        )
        return self.point(distance_m)

    def _leg(self, distance_m: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        return np.minimum(np.searchsorted(self._starts_m[1:], distance_m, side="right"), len(self.segments) - 1)

    def point(self, distance_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Return the points at distances along the track."""
        leg = self._leg(distance_m)
        points = np.empty((len(distance_m), 2))
        for number in np.unique(leg):
            rows = leg == number
            points[rows] = _along(distance_m[rows] - self._starts_m[number], self.segments[number])
        return points

    def direction(self, distance_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Return the unit vectors along the track."""
        leg = self._leg(distance_m)
        curvature, start_heading = (
            np.array([getattr(segment, key) for segment in self.segments]) for key in ("curvature_per_m", "heading_rad")
        )
        heading = start_heading[leg] + curvature[leg] * (distance_m - self._starts_m[leg])
        return np.column_stack([np.sin(heading), np.cos(heading)])

    def mean_curvature(self, distance_m: Float[np.ndarray, " n"], over_m: float) -> Float[np.ndarray, " n"]:
        """Return the mean curvature of the `over_m` metres centred on each distance; zero beyond the track."""
        return (self._turned(distance_m + over_m / 2) - self._turned(distance_m - over_m / 2)) / over_m

    def _turned(self, distance_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        steps = [segment.curvature_per_m * segment.length_m for segment in self.segments]
        return np.interp(distance_m, self._starts_m, np.concatenate([[0.0], np.cumsum(steps)]))

    def lines_m(self) -> tuple[tuple[float, float], ...]:
        """Return start and end distances along the track of each surveyed segment."""
        edges = zip(self._starts_m[:-1], self._starts_m[1:], self.segments, strict=True)
        return tuple((float(start), float(end)) for start, end, segment in edges if segment.on_line)


def rounded_track(waypoints_m: Float[np.ndarray, "k 2"], radius_m: float) -> CurvedTrack:
    """Return a polyline whose corners are arcs of a radius, tangent to both legs.

    Raises ScenarioError for a leg too short for the arcs at its ends, and for a turn back.
    """
    step = np.diff(waypoints_m, axis=0)
    length, heading = np.linalg.norm(step, axis=1), np.arctan2(step[:, 0], step[:, 1])
    turn = np.mod(np.diff(heading) + np.pi, 2 * np.pi) - np.pi
    if np.any(np.abs(turn) > MAX_TURN_RAD):
        corner = int(np.argmax(np.abs(turn))) + 1
        message = f"waypoint {corner} reverses direction, which an arc cannot; add a waypoint next to it"
        raise ScenarioError.of("platform.waypoints_m", message)
    tangent = np.concatenate([[0.0], radius_m * np.tan(np.abs(turn) / 2), [0.0]])
    straight = length - tangent[:-1] - tangent[1:]
    if np.any(straight < 0):
        leg = int(np.argmin(straight))
        fit_m = radius_m * length[leg] / (tangent[leg] + tangent[leg + 1])
        message = (
            f"a radius of {radius_m:.3g} m needs {tangent[leg] + tangent[leg + 1]:.3g} m for the turns at the ends of "
            f"leg {leg + 1}, which has {length[leg]:.3g}; give at most {0.99 * fit_m:.3g} m (bank more, or fly "
            "slower), or move the waypoints"
        )
        raise ScenarioError.of("platform.turn_radius_m", message)
    segments: list[TurnSegment] = []
    corner_m = (float(waypoints_m[0, 0]), float(waypoints_m[0, 1]))
    for leg in range(len(length)):
        segments.append(TurnSegment(start_m=corner_m, heading_rad=float(heading[leg]), length_m=float(straight[leg])))
        corner_m = segments[-1].end[:2]
        if leg < len(turn) and abs(turn[leg]) > MIN_TURN_RAD:
            curvature = float(np.sign(turn[leg])) / radius_m
            segments.append(
                TurnSegment(
                    start_m=corner_m,
                    heading_rad=float(heading[leg]),
                    length_m=float(abs(turn[leg])) * radius_m,
                    curvature_per_m=curvature,
                )
            )
            corner_m = segments[-1].end[:2]
    return CurvedTrack(segments=tuple(segment for segment in segments if segment.length_m > 0))


def shortest_way(
    start: tuple[float, float, float], end: tuple[float, float, float], radius_m: float
) -> Sequence[TurnSegment]:
    """Return the shortest path of a given turn radius between two poses (east, north, heading in rad).

    It has at most three segments: arc, straight, arc, or three arcs (Dubins 1957). None is surveyed.
    """
    shortest: list[tuple[float, float]] | None = None
    for turns in ((1, 0, 1), (-1, 0, -1), (1, 0, -1), (-1, 0, 1), (1, -1, 1), (-1, 1, -1)):
        lengths = _dubins(start, end, radius_m, turns)
        if lengths is not None and (shortest is None or sum(lengths) < sum(length for _, length in shortest)):
            shortest = [(turn / radius_m, length) for turn, length in zip(turns, lengths, strict=True)]
    assert shortest is not None  # two turns the same way always have a way
    segments: list[TurnSegment] = []
    pose = start
    for curvature, length in shortest:
        if length > 1e-9:
            segments.append(
                TurnSegment(
                    start_m=pose[:2], heading_rad=pose[2], length_m=length, curvature_per_m=curvature, on_line=False
                )
            )
            pose = segments[-1].end
    return segments


def _dubins(
    start: tuple[float, float, float], end: tuple[float, float, float], radius_m: float, turns: tuple[int, int, int]
) -> tuple[float, float, float] | None:
    """Return the lengths of three parts that turn right (1), left (-1) or not (0); None if there is no such path."""
    first_turn, middle_turn, last_turn = turns
    # Centres of the first and the last circle: to the right of the heading for a right turn.
    centres = [
        np.array(pose[:2]) + turn * radius_m * np.array([np.cos(pose[2]), -np.sin(pose[2])])
        for pose, turn in ((start, first_turn), (end, last_turn))
    ]
    step = centres[1] - centres[0]
    distance, bearing = float(np.hypot(*step)), float(np.arctan2(step[0], step[1]))
    if middle_turn == 0:
        if first_turn == last_turn:
            # On one and the same circle no straight leads from one arc to the other.
            heading, straight = bearing if distance > 1e-9 * radius_m else start[2], distance
        elif distance < 2 * radius_m:
            return None
        else:
            heading = bearing + first_turn * float(np.arcsin(2 * radius_m / distance))
            straight = float(np.sqrt((distance - 2 * radius_m) * (distance + 2 * radius_m)))
        arcs = _turned(heading - start[2], first_turn), _turned(end[2] - heading, last_turn)
        return arcs[0] * radius_m, straight, arcs[1] * radius_m
    if distance > 4 * radius_m:
        return None
    # The middle circle touches both; its centre lies to one side of the line between theirs.
    lean = float(np.arccos(distance / (4 * radius_m)))
    shortest = None
    for side in (1.0, -1.0):
        bearing_out = bearing + side * lean  # from the first centre to the middle one
        bearing_back = bearing - side * lean  # from the middle centre to the last
        # Where two circles touch, the heading is at right angles to the line between their centres.
        touch = bearing_out + first_turn * np.pi / 2, bearing_back + middle_turn * np.pi / 2
        arcs3 = (
            _turned(touch[0] - start[2], first_turn),
            _turned(touch[1] - touch[0], middle_turn),
            _turned(end[2] - touch[1], last_turn),
        )
        if shortest is None or sum(arcs3) < sum(shortest):
            shortest = arcs3
    assert shortest is not None
    return shortest[0] * radius_m, shortest[1] * radius_m, shortest[2] * radius_m


def _turned(angle: float, turn: int) -> float:
    """Return the non-negative angle (rad) of a turn in a given sense that changes the heading by `angle`."""
    around = float(np.mod(turn * angle, 2 * np.pi))
    return 0.0 if 2 * np.pi - around < 1e-9 else around


def banked(trajectory: Trajectory, track: CurvedTrack, speed_mps: float, roll_in_s: float) -> Trajectory:
    """Add the roll of coordinated turns to a trajectory."""
    start_s, end_s = trajectory.cruise_s()
    over_m = max(roll_in_s, 1e-6) * speed_mps
    # All arcs have one |curvature|: its running mean, scaled to the arc's bank, gives a constant roll rate.

    peak = max(abs(segment.curvature_per_m) for segment in track.segments)
    bank_m = float(np.arctan(speed_mps**2 * peak / gravity)) / peak if peak > 0 else 0.0

    def euler(time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        angles = trajectory.euler(time_s)
        curvature = track.mean_curvature((np.clip(time_s, start_s, end_s) - start_s) * speed_mps, over_m)
        angles[:, 0] += curvature * bank_m
        return angles

    return replace(trajectory, euler=euler)
