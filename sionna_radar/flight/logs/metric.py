"""A log in metres: its positions, velocities and attitudes in one level frame, grid north up.

On a map, east and north of the ground differ from those of the grid by the meridian convergence and the scale of the
projection. Both are taken where the flight is, as the derivative of the projection, and applied to
velocities (both) and headings (the convergence).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from pyproj import CRS, Geod
from scipy.spatial.transform import Rotation

from sionna_radar.elevation.map_frame import MapFrame
from sionna_radar.flight.logs.log import Attitudes, FlightLog, Positions, Spreads

STEP_M = 100.0


@dataclass(frozen=True, kw_only=True)
class MetricLog:
    """A log in local metres, headings from grid north.

    attitudes, spreads: None where the log has none.
    """

    positions: Positions
    attitudes: Attitudes | None
    spreads: Spreads | None


def in_metres(log: FlightLog, frame: MapFrame | None = None) -> MetricLog:
    """Return a log in the metres of a local frame on the map; without one, of a frame about its own middle.

    A log that is in metres already is returned as it is. Raises pyproj.exceptions.ProjError if the frame's projection
    cannot be applied; positions beyond it are not finite.
    """
    if not log.on_map:
        return MetricLog(positions=log.positions, attitudes=log.attitudes, spreads=log.spreads)
    lon, lat, height = log.positions.place.T
    lon = np.mod(lon - _near(lon) + 180.0, 360.0) - 180.0 + _near(lon)  # across the antimeridian
    middle = _middle(lon), _middle(lat)
    frame = frame or own_frame(*middle)
    with np.errstate(invalid="ignore"):
        valid = (np.abs(lat) <= 90) & (np.abs(lon) <= 540)
    east, north = frame.local_of(CRS(4326), np.where(valid, lon, np.nan), np.where(valid, lat, np.nan))
    J_grid_ground = grid_from_ground(frame, *middle)
    positions = replace(log.positions, place=np.column_stack([east, north, height]))
    if positions.velocity_mps is not None:
        across = positions.velocity_mps[:, :2] @ J_grid_ground.T
        positions = replace(positions, velocity_mps=np.column_stack([across, positions.velocity_mps[:, 2]]))
    attitudes = log.attitudes
    if attitudes is not None:
        # Grid north seen from true north, clockwise: headings from it are smaller by as much.
        convergence = -float(np.arctan2(J_grid_ground[0, 1], J_grid_ground[1, 1]))
        turn = Rotation.from_euler("z", -convergence)
        attitudes = replace(attitudes, quaternion=(turn * Rotation.from_quat(attitudes.quaternion)).as_quat())
    return MetricLog(positions=positions, attitudes=attitudes, spreads=log.spreads)


def own_frame(lon_deg: float, lat_deg: float) -> MapFrame:
    """Return a frame about a place whose metres are those of the ground, and whose north is true there."""
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
    known = lon[np.isfinite(lon)]
    return float(known[0]) if len(known) else 0.0


def _middle(values: Float[np.ndarray, " n"]) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
