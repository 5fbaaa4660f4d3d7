"""Planned routes: a track over waypoints or parallel survey lines, and its flight over given ground.

A `Route` fixes track, speed and height above ground; `fly` adds terrain, bank in turns, wind, and pauses of the
transmitter between lines. Lines are flown to and fro, with transits between them.
"""

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from sionna_radar.flight.gusts import Wind, in_wind
from sionna_radar.flight.trajectory import Course, Flight, FlightPlan, plan_trajectory
from sionna_radar.flight.turns import CurvedTrack, TurnSegment, banked, shortest_way
from sionna_radar.flight.vehicle import on_wheels
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Heights, box_around

Place = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class SurveyLines:
    """Parallel lines about a centre; `crossing` adds a second set at right angles to the first."""

    count: int
    spacing_m: float
    length_m: float
    centre_m: tuple[float, float] = (0.0, 0.0)
    crossing: bool = False


def lines_track(survey: SurveyLines, heading_rad: float, radius_m: float | None, lead_m: float = 0.0) -> CurvedTrack:
    """Return the track over all lines.

    survey: the lines.
    heading_rad: of the first one.
    radius_m: of the turns between lines; None for straight transits with instantaneous turns.
    lead_m: straight flight before and after each line, in which the aircraft rolls level.
    """
    lines = _lines(survey, heading_rad)
    if survey.crossing:
        # Crossing lines at +90 or -90 degrees: the set that begins nearest to the last line's end.
        last_end = lines[-1][1]
        turns = (np.pi / 2, -np.pi / 2)
        sets = [_lines(survey, heading_rad + turn, mirrored=mirrored) for turn in turns for mirrored in (False, True)]
        ways_m = [np.hypot(first_line[0][0] - last_end[0], first_line[0][1] - last_end[1]) for first_line, *_ in sets]
        lines += sets[int(np.argmin(ways_m))]
    segments: list[TurnSegment] = []
    for start, end in lines:
        length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
        if segments:
            segments += _between(segments[-1].end, start, radius_m, lead_m)
        segments.append(TurnSegment(start_m=start[:2], heading_rad=start[2], length_m=length))
    return CurvedTrack(segments=tuple(segments))


def _lines(survey: SurveyLines, heading_rad: float, *, mirrored: bool = False) -> list[tuple[Place, Place]]:
    """Return the ends of parallel lines, with their headings."""
    centre = np.array(survey.centre_m)
    forward = np.array([np.sin(heading_rad), np.cos(heading_rad)])
    right = np.array([forward[1], -forward[0]]) * (-1 if mirrored else 1)
    lines = []
    for line in range(survey.count):
        sign = 1 - 2 * (line % 2)
        middle = centre + (line - (survey.count - 1) / 2) * survey.spacing_m * right
        heading = heading_rad if sign > 0 else heading_rad + np.pi
        ends = [middle + end_sign * sign * survey.length_m / 2 * forward for end_sign in (-1, 1)]
        poses = [(float(end[0]), float(end[1]), float(heading)) for end in ends]
        lines.append((poses[0], poses[1]))
    return lines


def _between(start: Place, end: Place, radius_m: float | None, lead_m: float) -> list[TurnSegment]:
    """Return the transit from the end of a line to the start of the next."""
    if radius_m is None:
        east, north = end[0] - start[0], end[1] - start[1]
        length = float(np.hypot(east, north))
        if length == 0:
            return []
        heading = float(np.arctan2(east, north))
        return [TurnSegment(start_m=start[:2], heading_rad=heading, length_m=length, on_line=False)]
    lead_out = [TurnSegment(start_m=start[:2], heading_rad=start[2], length_m=lead_m, on_line=False)] if lead_m else []
    departure = lead_out[-1].end if lead_out else start
    approach = (end[0] - lead_m * np.sin(end[2]), end[1] - lead_m * np.cos(end[2]), end[2])
    segments = [*lead_out, *shortest_way(departure, (float(approach[0]), float(approach[1]), approach[2]), radius_m)]
    if lead_m:
        segments.append(TurnSegment(start_m=approach[:2], heading_rad=end[2], length_m=lead_m, on_line=False))
    return segments


PLACES_CHECKED = 200
# Gusts displace the aircraft by metres.
WIND_MARGIN_M = 20.0


@runtime_checkable
class Route(Protocol):
    """A flight before the ground under it is known.

    altitude_m: nominal height above ground; None if it depends on the ground.
    speed_mps, duration_s, length_m: nominal ground speed, and the time and length in which the radar may transmit.
    """

    @property
    def altitude_m(self) -> float | None:
        """See the class."""

    @property
    def speed_mps(self) -> float:
        """See the class."""

    @property
    def length_m(self) -> float:
        """See the class."""

    @property
    def duration_s(self) -> float:
        """See the class."""

    def window_m(self, reach_m: float) -> tuple[float, float, float, float]:
        """Return the bounding box of the track widened by `reach_m`: west, south, east, north."""

    def fly(self, ground_m: Heights, seed: int, origin_height_m: float = 0.0) -> Flight:
        """Return the flight over ground of given heights.

        seed: of its random part. origin_height_m: height on the map of the local frame's zero. Raises
        ScenarioError where the flight leaves the ground, or a log flies under it.
        """


@dataclass(frozen=True, kw_only=True)
class PlannedRoute:
    """A planned flight along a track; a `Route`.

    roll_in_s: time to roll into a turn, and out of it.
    transmit_in_turns: whether the radar also transmits between the lines of a curved track.
    wind: None for still air.
    off_ground: key of the scenario's platform and remedy, for a track that leaves the ground.
    """

    plan: FlightPlan
    track: Course
    roll_in_s: float = 1.0
    transmit_in_turns: bool = True
    wind: Wind | None = None
    off_ground: tuple[str, str]

    @property
    def altitude_m(self) -> float:
        """Height above the ground under the start."""
        return self.plan.altitude_m

    @property
    def speed_mps(self) -> float:
        """Speed over the ground."""
        return self.plan.speed_mps

    @property
    def length_m(self) -> float:
        """Length of the track."""
        return self.track.length_m

    @property
    def duration_s(self) -> float:
        """Duration of the cruise."""
        return self.track.length_m / self.speed_mps

    def window_m(self, reach_m: float) -> tuple[float, float, float, float]:
        """Return the bounding box of the track widened by `reach_m`: west, south, east, north."""
        if self.wind is not None:
            reach_m += WIND_MARGIN_M
        return box_around(self.track.waypoints_m, reach_m)

    def fly(self, ground_m: Heights, seed: int, origin_height_m: float = 0.0) -> Flight:
        """Return the flight over ground of given heights; ScenarioError where the track leaves it."""
        del origin_height_m  # its heights count from the ground
        self._check(ground_m)
        altitude_m, speed_mps = self.altitude_m, self.speed_mps
        if self.plan.wheels_m is not None:
            trajectory = on_wheels(self.track, speed_mps, altitude_m, self.plan.wheels_m, ground_m)
            return Flight(trajectory=trajectory, altitude_m=altitude_m, speed_mps=speed_mps)
        trajectory = plan_trajectory(self.plan, self.track, ground_m)
        if isinstance(self.track, CurvedTrack):
            trajectory = banked(trajectory, self.track, speed_mps, self.roll_in_s)
            if not self.transmit_in_turns:
                start_s = trajectory.cruise_s()[0]
                lines_m = self.track.lines_m()
                intervals_s = tuple((start_s + a / speed_mps, start_s + b / speed_mps) for a, b in lines_m)
                trajectory = replace(trajectory, transmits_s=intervals_s)
        if self.wind is not None:
            trajectory = in_wind(trajectory, self.wind, altitude_m, speed_mps, seed)
        return Flight(trajectory=trajectory, altitude_m=altitude_m, speed_mps=speed_mps)

    def _check(self, ground_m: Heights) -> None:
        points = self.track.point(np.linspace(0.0, self.track.length_m, PLACES_CHECKED))
        off_ground = np.isnan(ground_m(points))
        if off_ground.any():
            x, y = points[off_ground][0]
            key, remedy = self.off_ground
            message = f"the track has no ground under it at ({x:.1f}, {y:.1f}) m; {remedy}, or enlarge the terrain"
            raise ScenarioError.of(f"platform.{key}", message)
