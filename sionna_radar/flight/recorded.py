"""A recorded flight: a part of a log, interpolated by splines and placed over the ground of a scenario.

The splines pass through positions and attitudes. Positions with velocities: cubic Hermite splines, which pass through
both, once the velocities have taken the rounding out of the positions. Without velocities: modified Akima splines,
whose velocity is continuous and whose response to a single bad fix is local; a spline with a continuous acceleration
would ring through the whole log, and a monotone one flattens every turn. Attitudes: rotation splines (continuous
angular acceleration); across gaps long against their rate, the shortest rotation at a constant rate, since a rotation
spline may overshoot there.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from pyproj.exceptions import ProjError
from scipy.interpolate import Akima1DInterpolator, CubicHermiteSpline, PPoly
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.flight.log import Attitudes, FlightLog, Positions, Spreads, in_metres
from sionna_radar.flight.log_cleaning import CleanLog, Finding, clean, one_time
from sionna_radar.flight.trajectory import Flight, Phase, Trajectory
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Heights, box_around

# A gap in the attitudes: least ratio to the median step, and least length.
GAP_RATIO, MIN_GAP_S = 5.0, 0.5
# Below this ground speed the course does not determine the heading.
MIN_COURSE_MPS = 1.0


def position_spline(positions: Positions, start_s: float) -> PPoly:
    """Return a spline of the positions against the time since a start."""
    time_s = positions.time_s - start_s
    if positions.velocity_mps is not None:
        place = unrounded(time_s, positions.place, positions.velocity_mps)
        return CubicHermiteSpline(time_s, place, positions.velocity_mps)
    return Akima1DInterpolator(time_s, positions.place, method="makima")


def unrounded(
    time_s: Float[np.ndarray, " n"], place: Float[np.ndarray, "n 3"], velocity_mps: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Return positions without the part of their noise, such as that of whole 1e-7 deg, that the velocities tell.

    A position less the integral of the velocities is a random walk w, of what the velocities err by, plus noise of the
    position itself. The covariance of successive increments is minus the noise's variance; that of increments over
    many steps beyond twice the noise's is the walk's. The estimate minimises sum (d - w)^2 / noise + sum (dw)^2 / walk.
    Positions without such noise, of three standard deviations, are returned as they are.
    """
    step_s = np.diff(time_s)
    flown = Akima1DInterpolator(time_s, velocity_mps, method="makima").antiderivative()(time_s)
    apart, count = place - flown, len(place)
    smooth, many = apart.copy(), int(np.sqrt(count))
    for axis, d in enumerate(apart.T):
        increment = np.diff(d)
        product = increment[1:] * increment[:-1]
        noise = -float(product.sum()) / count
        # One jump is no noise: its product is as large as its standard deviation.
        if noise * count <= 3 * np.sqrt(product @ product):
            continue
        # A walk that stays under the noise through the whole log cannot be told from none.
        walk = max((float(np.mean((d[many:] - d[:-many]) ** 2)) - 2 * noise) / many, noise / count)
        tie = noise / walk * np.mean(step_s) / step_s
        diagonal = 1 + np.pad(tie, (1, 0)) + np.pad(tie, (0, 1))
        smooth[:, axis] = solveh_banded([np.pad(-tie, (1, 0)), diagonal], d)
    return place + (smooth - apart)


@dataclass(frozen=True, kw_only=True)
class AttitudeSpline:
    """Attitudes against time, held constant before the first and after the last."""

    starts_s: Float[np.ndarray, " part"]
    parts: tuple[Callable[[Float[np.ndarray, " n"]], Rotation], ...]
    span_s: tuple[float, float]

    def euler(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return roll, pitch and heading."""
        time_s = np.clip(time_s, *self.span_s)
        piece_index = np.maximum(np.searchsorted(self.starts_s, time_s, side="right") - 1, 0)
        angles = np.empty((len(time_s), 3))
        with warnings.catch_warnings():
            # Gimbal lock (nose straight up): any split between heading and roll is valid.
            warnings.filterwarnings("ignore", message="Gimbal lock")
            for piece in np.unique(piece_index):
                rows = piece_index == piece
                angles[rows] = self.parts[piece](time_s[rows]).as_euler("ZYX")[:, ::-1]
        return angles


def attitude_spline(attitudes: Attitudes, start_s: float) -> AttitudeSpline:
    """Return a spline of the attitudes against the time since a start."""
    time_s = attitudes.time_s - start_s
    rotations = Rotation.from_quat(attitudes.quaternion)
    step = np.diff(time_s)
    gap = (step > MIN_GAP_S) & (step > GAP_RATIO * np.median(step))
    edges = np.unique(np.concatenate([[0], np.flatnonzero(gap), np.flatnonzero(gap) + 1, [len(time_s) - 1]]))
    pieces: list[Callable[[Float[np.ndarray, " n"]], Rotation]] = []
    for start, stop in pairwise(edges.tolist()):
        build = Slerp if stop == start + 1 else RotationSpline
        pieces.append(build(time_s[start : stop + 1], rotations[start : stop + 1]))
    return AttitudeSpline(
        starts_s=time_s[edges[:-1]], parts=tuple(pieces), span_s=(float(time_s[0]), float(time_s[-1]))
    )


def course_attitudes(positions: Positions) -> Attitudes:
    """Return level attitudes with the heading of the motion; a slow vehicle keeps its last heading."""
    velocity = position_spline(positions, 0.0)(positions.time_s, 1)
    course = np.arctan2(velocity[:, 0], velocity[:, 1])
    moving = np.hypot(velocity[:, 0], velocity[:, 1]) > MIN_COURSE_MPS
    moving = moving if moving.any() else np.ones(len(course), dtype=bool)
    last_moving = np.maximum.accumulate(np.where(moving, np.arange(len(course)), int(np.argmax(moving))))
    return Attitudes(
        source="course of the positions",
        time_s=positions.time_s,
        quaternion=Rotation.from_euler("z", course[last_moving][:, None]).as_quat(),
    )


def sigma_at(
    spreads: Spreads, start_s: float
) -> Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, "n 3 3"]] | None:
    """Return standard deviations against the time since a start; None without any valid ones."""
    columns = np.column_stack([spreads.position_m, spreads.velocity_mps, spreads.attitude_rad])
    valid = np.isfinite(columns) & (columns >= 0)
    if not valid.any():
        return None
    time_s = spreads.time_s - start_s

    def sigma(at_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
        sigmas = np.full((len(at_s), 9), np.nan)
        for axis in np.flatnonzero(valid.any(axis=0)):
            rows = valid[:, axis]
            sigmas[:, axis] = np.interp(at_s, time_s[rows], columns[rows, axis])
        return sigmas.reshape(-1, 3, 3)

    return sigma


KEY = "platform.log"
# Largest number of samples for heights and speeds.
MAX_LOOKS = 5000
# Quantile of the ground speed: echoes are sparsest where the flight is fast.
FAST_SHARE = 0.95
FARTHEST_M = 1e6


@dataclass(frozen=True, kw_only=True)
class LogPart:
    """A part of a flight log, and how it is placed.

    path: its file.
    start_s, stop_s: of the part, from its first position.
    gap_s: longest time without a position or an attitude that is interpolated.
    shift: "to_terrain" moves its middle to the local origin; or metres east, north, up.
    height: what its heights are taken for, as `platform.log_height`; None chooses by the log.
    """

    path: Path
    start_s: float = 0.0
    stop_s: float = np.inf
    gap_s: float = 2.0
    shift: Literal["to_terrain"] | tuple[float, float, float] = (0.0, 0.0, 0.0)
    height: str | float | None = None


@dataclass(frozen=True, kw_only=True)
class RecordedRoute:
    """A part of a log in the metres of a scenario, before it is placed over its ground; a `Route`.

    part: how it is cut out and placed.
    clean: the part; its times count from the log's first position, and its heights are those of the log.
    takeoff_m: the log's first position, in the same metres.
    height: as `platform.log_height`, with its default resolved.
    """

    part: LogPart
    log: FlightLog
    clean: CleanLog
    attitudes: Attitudes
    takeoff_m: tuple[float, float, float]
    height: str | float

    altitude_m: float | None = None

    @property
    def span_s(self) -> tuple[float, float]:
        """Start and end of the positions with an attitude, from the log's first position."""
        start, stop = self.clean.span_s
        return max(start, float(self.attitudes.time_s[0])), min(stop, float(self.attitudes.time_s[-1]))

    @property
    def duration_s(self) -> float:
        """Duration."""
        start, stop = self.span_s
        return stop - start

    @cached_property
    def _looks_s(self) -> Float[np.ndarray, " n"]:
        return np.linspace(0.0, self.duration_s, min(MAX_LOOKS, max(int(self.duration_s * 10), 50)))

    @cached_property
    def _path(self) -> Any:
        return position_spline(self.clean.positions, self.span_s[0])

    @cached_property
    def speed_mps(self) -> float:
        """Ground speed exceeded during 5 % of the flight."""
        velocity = self._path(self._looks_s, 1)
        return max(float(np.quantile(np.hypot(velocity[:, 0], velocity[:, 1]), FAST_SHARE)), 1e-3)

    @cached_property
    def length_m(self) -> float:
        """Length of the ground track."""
        return float(np.linalg.norm(np.diff(self._path(self._looks_s)[:, :2], axis=0), axis=1).sum())

    def window_m(self, reach_m: float) -> tuple[float, float, float, float]:
        """Return the bounding box of the track widened by `reach_m`: west, south, east, north."""
        position = self._path(self._looks_s)[:, :2]
        if self.height == "above_takeoff":  # its ground height is needed
            position = np.vstack([position, self.takeoff_m[:2]])
        return box_around(position, reach_m)

    def fly(self, ground_m: Heights, seed: int, origin_height_m: float = 0.0) -> Flight:
        """Return the flight over ground of given heights.

        Raises ScenarioError, with the time in the log, where it leaves the ground or flies under it.
        """
        del seed  # a log has no random part
        start_s, _ = self.span_s
        position = self._path(self._looks_s)
        ground = ground_m(position[:, :2])
        if np.isnan(ground).any():
            gap = int(np.argmax(np.isnan(ground)))
            x, y, _ = position[gap]
            message = (
                f"has no ground under it {start_s + self._looks_s[gap]:.1f} s into the log, at ({x:.1f}, {y:.1f}) m; "
                "choose a part with log_start_s and log_stop_s, move it with log_shift = 'to_terrain' or by metres, or "
                "enlarge the terrain"
            )
            raise ScenarioError.of(KEY, message)
        offset_m, heights = self._raised(ground_m, position, ground, origin_height_m)
        clearance = position[:, 2] + offset_m - ground
        if clearance.min() <= 0:
            lowest = int(np.argmin(clearance))
            message = (
                f"is {-clearance[lowest]:.1f} m under the ground {start_s + self._looks_s[lowest]:.1f} s into the log "
                f"({heights}); check the datum of its heights: set log_height, or raise it with log_shift; take-off "
                "and landing are left out with log_start_s and log_stop_s"
            )
            raise ScenarioError.of(KEY, message)
        altitude_m = float(np.median(clearance))
        return Flight(
            trajectory=self.trajectory(offset_m),
            altitude_m=altitude_m,
            speed_mps=self.speed_mps,
            record=self._record(altitude_m, clearance, heights),
            warnings=self._warnings(heights),
        )

    def _raised(
        self,
        ground_m: Heights,
        position: Float[np.ndarray, "n 3"],
        ground: Float[np.ndarray, " n"],
        origin_height_m: float,
    ) -> tuple[float, str]:
        """Return the offset added to the log's heights, m, and a description of their assumed reference."""
        shift = self.part.shift
        vertical_shift_m = 0.0 if isinstance(shift, str) else shift[2]
        if isinstance(self.height, float):
            return float(ground[0] - position[0, 2]) + self.height, f"its first place {self.height:g} m up"
        if self.height == "datum":
            # Metres of a log without a map are the scenario's own.
            return (
                vertical_shift_m - origin_height_m * self.log.on_map,
                "its heights taken as in the vertical datum of the terrain",
            )
        takeoff_ground_m = float(ground_m(np.array([self.takeoff_m[:2]]))[0])
        if np.isnan(takeoff_ground_m):
            message = (
                "'above_takeoff' needs ground under the first position of the log, which is at "
                f"({self.takeoff_m[0]:.1f}, {self.takeoff_m[1]:.1f}) m; give the height in metres of the first place "
                "that is flown, or enlarge the terrain"
            )
            raise ScenarioError.of("platform.log_height", message)
        return takeoff_ground_m - self.takeoff_m[2] + vertical_shift_m, "its first position taken as on the ground"

    def trajectory(self, offset_m: float) -> Trajectory:
        """Return the flight at heights of the log plus an offset; its time counts from the start of `span_s`."""
        start_s, _ = self.span_s
        path, attitudes = self._path, attitude_spline(self.attitudes, start_s)
        offset = np.array([0.0, 0.0, offset_m])

        def position(time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
            return path(time_s) + offset

        def velocity(time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
            return path(time_s, 1)

        return Trajectory(
            position=position,
            velocity=velocity,
            euler=attitudes.euler,
            phases=((Phase.CRUISE, 0.0, self.duration_s),),
            logged_sigma=None if self.clean.spreads is None else sigma_at(self.clean.spreads, start_s),
        )

    def _warnings(self, heights: str) -> tuple[str, ...]:
        messages = []
        if self.height == "datum" and self.log.on_map:
            level = "an unknown level" if self.log.datum == "unknown" else self.log.datum
            messages.append(
                f"{KEY}: {heights}, without a change of datum (they count from {level}); set log_height or log_shift "
                "if the summary's heights above ground are not those flown"
            )
        if self.log.attitudes is None:
            messages.append(f"{KEY}: it has no attitude; the aircraft is level, and heads where it moves")
        return tuple(messages)

    def _record(self, altitude_m: float, clearance: Float[np.ndarray, " n"], heights: str) -> dict[str, Any]:
        start_s, stop_s = self.span_s
        velocity = self._path(self._looks_s, 1)
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        from_positions = self.log.positions.velocity_mps is None
        return {
            "path": str(self.part.path),
            "format": self.log.kind,
            "start_s": start_s,
            "stop_s": stop_s,
            "positions": self.log.positions.source,
            "velocities": "of the positions' spline" if from_positions else self.log.positions.source,
            "attitudes": self.attitudes.source,
            "errors": None if self.clean.spreads is None else self.clean.spreads.source,
            "sources": [{"name": s.name, "rows": s.rows, "rate_hz": s.rate_hz} for s in self.log.sources],
            "heights": heights,
            "height_above_ground_m": {
                "least": float(clearance.min()), "median": altitude_m, "greatest": float(clearance.max())
            },
            "speed_mps": {"least": float(speed.min()), "mean": float(speed.mean()), "greatest": float(speed.max())},
            "length_m": self.length_m,
            "longest_step_s": float(np.diff(self.clean.positions.time_s).max()),
            "notes": [*self.log.notes, *self.clean.notes],
        }  # fmt: skip


def recorded_route(log: FlightLog, part: LogPart, frame: Callable[[], MapFrame | None]) -> RecordedRoute:
    """Return the recorded flight of a scenario.

    log, part: the log, and the part of it that is flown, with how it is placed.
    frame: returns the local frame on the map, if the terrain has one.

    Raises InputFileError if the part of the log is unusable: with the time, and a remedy.
    Raises ScenarioError if it is on the map and the terrain is not, or the part begins after its end.
    """
    last_s = float(np.nanmax(log.positions.time_s))
    if last_s <= 0:
        raise InputFileError(f"{KEY} = {shown(part.path)}: {one_time(log)}")
    if part.start_s >= last_s:
        message = f"{part.start_s:g} is behind the end of the log, at {last_s:.1f} s; lower it"
        raise ScenarioError.of("platform.log_start_s", message)
    moved = part.shift == "to_terrain"
    metric = _placed(log, None if moved else frame, part.path)
    log_part = clean(metric, part.start_s, part.stop_s, part.gap_s)
    _refuse(log_part.findings, part.path)
    attitudes = log_part.attitudes or course_attitudes(log_part.positions)
    finite = np.isfinite(metric.positions.place).all(axis=1)
    takeoff = metric.positions.place[int(np.argmax(finite))]
    shift = _shift(part, log_part.positions)
    route = RecordedRoute(
        part=part,
        log=log,
        clean=replace(log_part, positions=replace(log_part.positions, place=log_part.positions.place + shift)),
        attitudes=attitudes,
        takeoff_m=(float(takeoff[0] + shift[0]), float(takeoff[1] + shift[1]), float(takeoff[2])),
        height=part.height or ("above_takeoff" if moved or log.datum == "take-off" else "datum"),
    )
    farthest = float(np.abs(route.clean.positions.place).max())
    if farthest > FARTHEST_M:
        message = (
            f"is {farthest / 1000:,.0f} km from the terrain's middle; is it a log of this place? Move it with "
            "log_shift = 'to_terrain'"
        )
        raise ScenarioError.of(KEY, message)
    if route.duration_s <= 0:
        message = f"{KEY} {shown(part.path)}: its positions and attitudes have no time in common; give another part"
        raise InputFileError(message)
    return route


def _placed(log: FlightLog, frame: Callable[[], MapFrame | None] | None, path: Path) -> FlightLog:
    if not log.on_map or frame is None:
        return in_metres(log)
    map_frame = frame()
    if map_frame is None:
        message = (
            "has longitude and latitude, and the terrain is on no map; set log_shift = 'to_terrain', or "
            "terrain.centre_lonlat_deg"
        )
        raise ScenarioError.of(KEY, message)
    try:
        return in_metres(log, map_frame)
    except ProjError as error:
        message = f"{KEY} {shown(path)} cannot be put into {map_frame.crs.name!r} ({error}); check the terrain's CRS"
        raise InputFileError(message) from error


def _refuse(findings: tuple[Finding, ...], path: Path) -> None:
    if findings:
        count_note = f" (and {len(findings) - 1:,} more)" if len(findings) > 1 else ""
        raise InputFileError(f"{KEY} {shown(path)}: at {findings[0].time_s:.2f} s: {findings[0].message}{count_note}")


def _shift(part: LogPart, positions: Positions) -> Float[np.ndarray, " 3"]:
    """Return the horizontal shift of the flight, m; the vertical shift follows once the ground is known."""
    if isinstance(part.shift, str):
        lower, upper = positions.place.min(axis=0), positions.place.max(axis=0)
        return np.array([*(-(lower + upper)[:2] / 2), 0.0])
    return np.array([*part.shift[:2], 0.0])
