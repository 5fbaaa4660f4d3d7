"""Tables `[platform]` (flight path, log, wind) and `[platform.navigation]` (errors of the measured pose)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, field_validator

from sionna_radar.foundation.input_file import shown
from sionna_radar.scenario.bases import AttitudeErrorAxes, AttitudeSpreadAxes, NavigationParameters, Offset, SpreadAxes
from sionna_radar.scenario.choice import ChosenBy
from sionna_radar.scenario.overrides import PLAN_KEYS
from sionna_radar.scenario.parts import NAVIGATIONS
from sionna_radar.scenario.table import Conflicts, InputPath, NonNegative, Point2, Positive, Real, Table, refuse

Axes = Offset | tuple[Offset, Offset, Offset]
Wheels = Annotated[Real, Field(ge=0.05, le=20.0)]


class LoggedErrorsTable(NavigationParameters):
    """Errors as large as the log of the flight states: `navigation = "from_log"`.

    Standard deviations come from the covariance of the log's filter, or else from its innovations; what errs in the
    flight is a first-order Gauss-Markov process of that size, drawn from the seed. Components of the pose without
    stated errors are known exactly.
    """

    kind: Literal["from_log"] = "from_log"
    correlation_s: tuple[Positive, Positive, Positive] = (60.0, 10.0, 60.0)
    """Correlation times of the errors of position, velocity and attitude, as in `NavigationTable`."""


class NavigationTable(NavigationParameters):
    """Errors of the measured pose; one number for all three axes, or one for each.

    Position and velocity count east, north, up; attitude counts roll, pitch, heading. A key named markov is a
    first-order Gauss-Markov process with a correlation time. The lever arm leads from the navigation system to
    the antenna (nose, right, down) and is believed to be longer by its error; the mount of the antenna is
    believed to be turned by boresight_error_deg about the same axes.
    """

    kind: Literal["errors"] = "errors"
    position_constant_m: Axes = 0.0
    """Constant error of the position."""
    position_white_m: SpreadAxes = 0.0
    """Standard deviation of the position's white noise, from chirp to chirp."""
    position_markov_m: SpreadAxes = 0.0
    """Standard deviation of the position's Gauss-Markov error."""
    position_correlation_s: Positive = 60.0
    """Correlation time of the position's Gauss-Markov error."""
    velocity_constant_mps: Axes = 0.0
    """Constant error of the velocity."""
    velocity_white_mps: SpreadAxes = 0.0
    """Standard deviation of the velocity's white noise, from chirp to chirp."""
    velocity_markov_mps: SpreadAxes = 0.0
    """Standard deviation of the velocity's Gauss-Markov error."""
    velocity_correlation_s: Positive = 10.0
    """Correlation time of the velocity's Gauss-Markov error."""
    attitude_constant_deg: AttitudeErrorAxes = 0.0
    """Constant error of the attitude."""
    attitude_white_deg: AttitudeSpreadAxes = 0.0
    """Standard deviation of the attitude's white noise, from chirp to chirp."""
    attitude_markov_deg: AttitudeSpreadAxes = 0.0
    """Standard deviation of the attitude's Gauss-Markov error."""
    attitude_correlation_s: Positive = 60.0
    """Correlation time of the attitude's Gauss-Markov error."""
    time_offset_s: Offset = 0.0
    """Lag of the reported pose behind the radar's clock."""
    lever_arm_error_m: Axes = 0.0
    """Error of the lever arm, believed minus true: nose, right, down."""
    boresight_error_deg: AttitudeErrorAxes = 0.0
    """Error of the antenna's mounting angles, believed minus true, about the nose, right and down axes."""

    @property
    def has_errors(self) -> bool:
        """Whether the measured pose differs from the true one."""
        harmless = {"kind", "lever_arm_m"} | {
            name for name in type(self).model_fields if name.endswith("_correlation_s")
        }
        values = (getattr(self, name) for name in type(self).model_fields if name not in harmless)
        return any(np.any(np.asarray(value) != 0) for value in values)


ACCEPTED_VALUES = {
    "log_shift": "'none', 'to_terrain' or metres [east, north, up]",
    "log_height": "'datum', 'above_takeoff' or the metres above the ground at which it begins",
}
LOG_KEYS = ("log_start_s", "log_stop_s", "log_shift", "log_height", "log_gap_s", "log_columns", "log_crs")
Shift = Annotated[Real, Field(ge=-1e7, le=1e7)]


class WindTable(Table):
    """Wind and its gusts: `[platform.wind]`.

    The flight keeps its ground speed and its track. With `crab` the nose points along the motion through the air, as
    that of an aeroplane; without, along the track, as that of a multirotor.
    """

    speed_mps: Annotated[NonNegative, Field(le=100.0)] = 0.0
    """Mean wind speed."""
    from_deg: Real = 0.0
    """Direction that the wind comes from, clockwise from grid north."""
    gust_mps: Annotated[NonNegative, Field(le=50.0)] | None = None
    """Standard deviation of the vertical gusts; that of the horizontal ones follows from the height. Default: a tenth
    of the wind at 20 feet (MIL-F-8785C), taken as the mean wind."""
    crab: bool = Field(default=True, strict=True)
    """Whether the nose points along the motion through the air."""
    attitude_response_s: Annotated[Positive, Field(ge=0.01, le=100.0)] = 0.5
    """Time constant with which the attitude follows the angle of the gusts."""
    position_response_s: Annotated[Positive, Field(ge=0.05, le=100.0)] = 1.0
    """Period of the autopilot's position loop over 2 pi; gusts displace the aircraft, and it returns."""


class LinesTable(Table):
    """Several parallel lines over one area, flown to and fro: `lines = { ... }`.

    They run along `platform.heading_deg`, side by side about centre_m. With bank_deg or turn_radius_m the
    aircraft turns outside of them, in a bulb where they are nearer than two radii.
    """

    count: Annotated[int, Field(strict=True, ge=1, le=1000)]
    """Number of lines."""
    spacing_m: Positive
    """Distance between neighbouring lines."""
    length_m: Positive
    """Length of each line."""
    centre_m: Point2 | None = None
    """Middle of the area, east and north. Default: the local origin."""
    crossing: bool = Field(default=False, strict=True)
    """Whether a second set of lines, at right angles, is flown after the first."""
    transmit_in_turns: bool = Field(default=False, strict=True)
    """Whether the radar also transmits on the way from one line to the next."""


class Platform(Table):
    """The flight: straight legs, level or following the terrain, with or without take-off and landing; or a log.

    Planned flights
    ---------------

    Recorded flights
    ----------------
    """

    log: InputPath | None = None
    """Flight log to fly along: PX4 ULog, ArduPilot DataFlash or telemetry log, SBET, GPX, CSV or HELIOS++ trajectory;
    see `sionna_radar.readers.logs.csv_log`."""
    altitude_m: Annotated[Positive, Field(le=1e5)] | None = None
    """Height above the ground under the start."""
    speed_mps: Annotated[Positive, Field(le=1e4)] | None = None
    """Ground speed."""
    start_m: Point2 | None = None
    """Start of the track: east and north. Default: the track is centred on the local origin."""
    heading_deg: Real = 90.0
    """Heading of the track, clockwise from grid north."""
    length_m: Positive = 100.0
    """Length of the track."""
    waypoints_m: tuple[Point2, ...] = ()
    """Waypoints of the track, instead of start, heading and length."""
    height: Literal["level", "terrain_following", "sensed", "ground"] = "level"
    """Height profile: "level", or at `altitude_m` above the ground under the track. "terrain_following" knows a DEM
    ahead, and smooths it; "sensed" follows, with a delay, the height above the ground below as an altimeter without
    error reads it. "ground" is a vehicle that stands on its wheels, with their pitch and roll."""
    wheels_m: tuple[Wheels, Wheels] = (2.7, 1.6)
    """Distance between the axles, and between the wheels of one, of a vehicle on the ground."""
    follow_length_m: Positive = 50.0
    """Length over which a terrain-following flight smooths the DEM."""
    height_response_s: Annotated[Positive, Field(ge=0.01, le=100.0)] = 1.0
    """Time constant of the first-order response of the flight to a sensed height: over a slope the height lags by what
    the ground rises in that time."""
    profile: Literal["cruise", "full"] = "cruise"
    """Phases of the flight: the cruise alone, or with take-off and landing."""
    climb_rate_mps: Positive = 2.0
    """Climb rate of the take-off."""
    descent_rate_mps: Positive = 2.0
    """Descent rate of the landing."""
    acceleration_mps2: Positive = 2.0
    """Acceleration of take-off, climb, descent and landing."""
    takeoff_height_m: Positive = 5.0
    """Height above the ground at which the take-off ends and the climb begins."""
    bank_deg: Annotated[Positive, Field(le=80.0)] | None = None
    """Bank angle of the turns at waypoints, which are then arcs. Default: without it or `turn_radius_m`, turns are
    instantaneous."""
    turn_radius_m: Positive | None = None
    """Radius of the turns, instead of `bank_deg`."""
    roll_in_s: Annotated[NonNegative, Field(le=60.0)] = 1.0
    """Time that the aircraft takes to roll into a turn, and out of it."""
    wind: WindTable | None = None
    """Wind and gusts."""
    lines: LinesTable | None = None
    """Parallel lines over an area, instead of a single track."""
    log_start_s: NonNegative = 0.0
    """Start of the flown stretch of the log, counted from its first position."""
    log_stop_s: Positive | None = None
    """End of the flown stretch of the log, counted from its first position. Default: the end of the log."""
    log_shift: Literal["none", "to_terrain"] | tuple[Shift, Shift, Shift] = "none"
    """Horizontal and vertical shift of the log: "to_terrain" moves its middle to the local origin; or metres east,
    north and up."""
    log_height: Literal["datum", "above_takeoff"] | Annotated[Positive, Field(le=1e5)] | None = None
    """Reference of the log's heights. "datum": heights in the vertical datum of the terrain, without any change of
    datum (local metres for a log that is on no map). "above_takeoff": above the ground under the first position of the
    log. A number: the first position that is flown is this high above the ground. Default: "above_takeoff" for a log
    that is moved to the terrain, or whose heights count from its take-off, and "datum" otherwise."""
    log_gap_s: Annotated[Positive, Field(le=3600.0)] = 2.0
    """Longest time without a position or an attitude that is interpolated."""
    log_columns: dict[str, str] = {}
    """Columns of a CSV log by our names, where it has others: { time_s = "Zeit", height_m = "Höhe" }."""
    log_crs: str | None = None
    """Coordinate reference system, such as "EPSG:25832", of a CSV log in map coordinates: easting_m, northing_m,
    elevation_m or x, y, z. Its headings count from grid north there; its heights keep their datum."""
    navigation: Annotated[NavigationParameters, ChosenBy("kind", NAVIGATIONS, "errors", by_name=True)] = (
        NavigationTable()
    )
    """Errors of the measured pose, or "from_log" for errors as large as the log states."""

    @field_validator("altitude_m", "speed_mps")
    @classmethod
    def _planned_or_recorded(cls, value: float | None, info: Any) -> float | None:
        if value is None and "log" in info.data and info.data["log"] is None:
            raise refuse("", "missing; add it, or platform.log of a recorded flight")
        return value

    @field_validator("log_shift", "log_height", mode="wrap")
    @classmethod
    def _word_or_number(cls, value: Any, check: Any, info: Any) -> Any:
        """Say of a value that is neither a word nor a number once what it may be, and not once for each."""
        try:
            return check(value)
        except ValidationError as error:
            raise refuse("", f"must be {ACCEPTED_VALUES[info.field_name]}, not {shown(value)}") from error

    def _conflicts(self) -> Conflicts:
        planned, recorded = self.changed(*PLAN_KEYS), self.changed(*LOG_KEYS)
        if self.log is not None and planned:
            yield "log", f"contradicts {', '.join(planned)}; give the one or the other"
        if self.log is None and recorded:
            yield recorded[0], "has no effect without platform.log; remove it"
        if self.log_stop_s is not None and self.log_stop_s <= self.log_start_s:
            yield "log_stop_s", f"{self.log_stop_s:g} is not after log_start_s = {self.log_start_s:g}; raise it"
        yield from self._conflicts_of_tracks()

    def _conflicts_of_tracks(self) -> Conflicts:
        conflicts = self.changed("start_m", "length_m", "heading_deg")
        if self.waypoints_m and conflicts:
            yield "waypoints_m", f"contradicts {', '.join(conflicts)}; give the one or the other"
        line_conflicts = self.changed("start_m", "length_m", "waypoints_m")
        if self.lines is not None and line_conflicts:
            yield "lines", f"contradicts {', '.join(line_conflicts)}; give the one or the other"
        if len(self.waypoints_m) == 1:
            yield "waypoints_m", "a single waypoint; give at least two"
        for a, b in zip(self.waypoints_m[:-1], self.waypoints_m[1:], strict=True):
            if a == b:
                yield "waypoints_m", f"{a} follows itself; remove the repeated point"
        if self.bank_deg is not None and self.turn_radius_m is not None:
            yield "turn_radius_m", "contradicts bank_deg: speed and bank give the radius; remove the one"
        if self.height != "ground" and self.changed("wheels_m"):
            yield "wheels_m", "has no effect without height = 'ground'; remove it"
        off_wheels = self.changed("wind", "profile", "bank_deg") if self.height == "ground" else ()
        if off_wheels:
            yield off_wheels[0], "has no effect on a vehicle on the ground; remove it (its turns have a turn_radius_m)"
        if self.profile == "full" and self.altitude_m is not None and self.takeoff_height_m >= self.altitude_m:
            message = f"{self.takeoff_height_m:g} is not below altitude_m = {self.altitude_m:g}; lower it"
            yield "takeoff_height_m", message

    @property
    def planned(self) -> tuple[float, float]:
        """Altitude and speed of a planned flight, m and m/s."""
        assert self.altitude_m is not None  # checked with the table
        assert self.speed_mps is not None
        return self.altitude_m, self.speed_mps
