"""The content of a flight log, whatever its format, and the log in the metres of one level frame.

Times are seconds from the first position. Positions are east, north, up in metres about an origin of the log's own, or
longitude, latitude (WGS 84, degrees) and height. Velocities are east, north, up. Attitudes rotate body axes (nose,
right, down) to north, east, down; north is that of the positions: true north for longitude and latitude.

A log in metres has its positions, velocities and attitudes in one level frame, grid north up.

On a map, east and north of the ground differ from those of the grid by the meridian convergence and the scale of the
projection. Both are taken where the flight is, as the derivative of the projection, and applied to
velocities (both) and headings (the convergence).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float
from pyproj import CRS, Geod
from scipy.spatial.transform import Rotation

from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.foundation.columns import Columns

Datum = Literal["mean sea level", "ellipsoid", "unknown", "take-off"]


@dataclass(frozen=True, kw_only=True)
class Stream(Columns):
    """Columns of one source of a log, by their times."""

    time_s: Float[np.ndarray, " n"]
    source: str


@dataclass(frozen=True, kw_only=True)
class Positions(Stream):
    """Positions and their source.

    place: degrees and metres, or metres; see the module.
    velocity_mps: None where the source has none.
    """

    place: Float[np.ndarray, "n 3"]
    velocity_mps: Float[np.ndarray, "n 3"] | None = None


@dataclass(frozen=True, kw_only=True)
class Attitudes(Stream):
    """Attitudes as unit quaternions (x, y, z, w) from body to north-east-down."""

    quaternion: Float[np.ndarray, "n 4"]

    def turned(self, angle_rad: float) -> "Attitudes":
        """Return the attitudes with headings that are greater by an angle."""
        turn = Rotation.from_euler("z", angle_rad)
        return replace(self, quaternion=(turn * Rotation.from_quat(self.quaternion)).as_quat())


@dataclass(frozen=True, kw_only=True)
class Spreads(Stream):
    """Standard deviations stated by a log, or estimated from its innovations.

    position_m, velocity_mps: east, north, up; attitude_rad: roll, pitch, heading. NaN where unknown.
    """

    position_m: Float[np.ndarray, "n 3"]
    velocity_mps: Float[np.ndarray, "n 3"]
    attitude_rad: Float[np.ndarray, "n 3"]


@dataclass(frozen=True, kw_only=True)
class LogSource:
    """A stream of a log: its number of rows and time span."""

    name: str
    rows: int
    duration_s: float

    @property
    def rate_hz(self) -> float:
        """Mean rate."""
        return (self.rows - 1) / self.duration_s if self.rows > 1 and self.duration_s > 0 else 0.0


@dataclass(frozen=True, kw_only=True)
class FlightLog:
    """A log as it was read.

    kind: the format, in words; on_map: whether positions are longitude and latitude.
    datum: reference of the heights. sources: all streams of the file; notes: remarks of the reader.
    """

    kind: str
    on_map: bool
    datum: Datum
    positions: Positions
    attitudes: Attitudes | None
    spreads: Spreads | None
    sources: tuple[LogSource, ...]
    notes: tuple[str, ...] = ()


def source_of(name: str, time_s: Float[np.ndarray, " n"]) -> LogSource:
    """Return the source of some rows."""
    finite = time_s[np.isfinite(time_s)]
    return LogSource(name=name, rows=len(time_s), duration_s=float(np.ptp(finite)) if len(finite) else 0.0)


def spreads_of(
    source: str,
    time_s: Float[np.ndarray, " n"],
    position_m: Float[np.ndarray, "n 3"] | None = None,
    velocity_mps: Float[np.ndarray, "n 3"] | None = None,
    attitude_rad: Float[np.ndarray, "n 3"] | None = None,
) -> Spreads:
    """Return standard deviations; omitted ones are NaN."""
    nan_rows = np.full((len(time_s), 3), np.nan)
    return Spreads(
        source=source,
        time_s=time_s,
        position_m=nan_rows if position_m is None else position_m,
        velocity_mps=nan_rows if velocity_mps is None else velocity_mps,
        attitude_rad=nan_rows if attitude_rad is None else attitude_rad,
    )


def attitudes_of(
    source: str, time_s: Float[np.ndarray, " n"], euler: Float[np.ndarray, "n 3"], *, degrees: bool
) -> Attitudes | None:
    """Return attitudes from heading, pitch and roll, where all are finite; None without any."""
    finite = np.isfinite(euler).all(axis=1)
    if not finite.any():
        return None
    quaternion = Rotation.from_euler("ZYX", euler[finite], degrees=degrees).as_quat()
    return Attitudes(source=source, time_s=time_s[finite], quaternion=quaternion)


def innovations_of(
    source: str, time_s: Float[np.ndarray, " n"], columns: Mapping[str, Float[np.ndarray, " n"]], keys: Sequence[str]
) -> Spreads:
    """Return the running RMS of innovations: columns of position east, north and up, and of velocity."""
    position_m, velocity_mps = (
        running_rms(time_s, np.column_stack([columns[key] for key in group])) for group in (keys[:3], keys[3:])
    )
    return spreads_of(source, time_s, position_m, velocity_mps)


def running_rms(
    time_s: Float[np.ndarray, " n"], value: Float[np.ndarray, "n 3"], span_s: float = 10.0
) -> Float[np.ndarray, "n 3"]:
    """Return the root mean square of values in a time window about each; NaNs are ignored.

    Innovations, the differences between measured and predicted positions, hold the errors of both: their RMS is an
    upper bound of the error of the estimate as long as the two are independent.
    """
    order = np.argsort(time_s, kind="stable")
    sorted_s = time_s[order]
    finite = np.isfinite(value[order])
    total = np.vstack([np.zeros((1, 3)), np.cumsum(np.where(finite, value[order], 0.0) ** 2, axis=0)])
    count = np.vstack([np.zeros((1, 3)), np.cumsum(finite, axis=0)])
    start = np.searchsorted(sorted_s, sorted_s - span_s / 2, side="left")
    stop = np.searchsorted(sorted_s, sorted_s + span_s / 2, side="right")
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(np.maximum(total[stop] - total[start], 0.0) / (count[stop] - count[start]))
    unsorted: Float[np.ndarray, "n 3"] = np.empty_like(rms)
    unsorted[order] = rms
    return unsorted


STEP_M = 100.0


def convergence_rad(J_grid_ground: Float[np.ndarray, "2 2"]) -> float:
    """Return grid north seen from true north, clockwise: headings from it are smaller by as much."""
    return -float(np.arctan2(J_grid_ground[0, 1], J_grid_ground[1, 1]))


def in_metres(log: FlightLog, frame: MapFrame | None = None) -> FlightLog:
    """Convert a log to the metres of a local frame on the map; by default, of a frame about its own middle.

    Headings then count from grid north. A log already in metres is returned unchanged. Raises
    pyproj.exceptions.ProjError if the frame's projection cannot be applied; positions beyond it are not finite.
    """
    if not log.on_map:
        return log
    lon, lat, height = log.positions.place.T
    lon = np.mod(lon - _near(lon) + 180.0, 360.0) - 180.0 + _near(lon)  # across the antimeridian
    middle = _middle(lon), _middle(lat)
    frame = frame or local_frame_at(*middle)
    with np.errstate(invalid="ignore"):
        valid = (np.abs(lat) <= 90) & (np.abs(lon) <= 540)
    east, north = frame.local_of(CRS(4326), np.where(valid, lon, np.nan), np.where(valid, lat, np.nan))
    J_grid_ground = grid_from_ground(frame, *middle)
    positions = replace(log.positions, place=np.column_stack([east, north, height]))
    if positions.velocity_mps is not None:
        across = positions.velocity_mps[:, :2] @ J_grid_ground.T
        positions = replace(positions, velocity_mps=np.column_stack([across, positions.velocity_mps[:, 2]]))
    attitudes = None if log.attitudes is None else log.attitudes.turned(-convergence_rad(J_grid_ground))
    return replace(log, on_map=False, positions=positions, attitudes=attitudes)


def local_frame_at(lon_deg: float, lat_deg: float) -> MapFrame:
    """Return a frame about a place, of unit scale and true north there."""
    crs = CRS.from_dict({"proj": "tmerc", "lat_0": lat_deg, "lon_0": lon_deg, "datum": "WGS84", "units": "m"})
    return MapFrame(crs=crs, origin_m=(0.0, 0.0))


def grid_from_ground(frame: MapFrame, lon_deg: float, lat_deg: float) -> Float[np.ndarray, "2 2"]:
    """Return grid metres east and north (rows) for metres on the ground, east and north (columns)."""
    lon, lat, _ = Geod(ellps="WGS84").fwd([lon_deg] * 2, [lat_deg] * 2, [90.0, 0.0], [STEP_M] * 2)
    east, north = frame.local_of(CRS(4326), np.array([lon_deg, *lon]), np.array([lat_deg, *lat]))
    with np.errstate(invalid="ignore"):
        steps: Float[np.ndarray, "2 2"] = np.array([east[1:] - east[0], north[1:] - north[0]]) / STEP_M
    return steps if np.isfinite(steps).all() else np.eye(2)


def _near(lon: Float[np.ndarray, " n"]) -> float:
    finite = lon[np.isfinite(lon)]
    return float(finite[0]) if len(finite) else 0.0


def _middle(values: Float[np.ndarray, " n"]) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else 0.0
