"""PX4's ULog, read by pyulog.

`vehicle_local_position` is north, east, down about a reference that PX4 places on the map by an azimuthal equidistant
projection on a sphere (its MapProjection, src/lib/geo/geo.cpp), which is inverted here; without a reference the flight
is in local metres. The filter logs its position resets; earlier positions are shifted by them.
"""

import re
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from pyproj import Geod

from sionna_radar.flight.log import Attitudes, FlightLog, Positions, Spreads, innovations_of, source_of, spreads_of
from sionna_radar.foundation.errors import InputFileError, reason_of
from sionna_radar.foundation.input_file import regular_file, shown

MAX_BYTES = 1_000_000_000
# PX4's sphere (CONSTANTS_RADIUS_OF_EARTH).
SPHERE = Geod(a=6_371_000.0, b=6_371_000.0)
TOPICS = (
    "vehicle_local_position",
    "vehicle_global_position",
    "vehicle_gps_position",
    "vehicle_attitude",
    "estimator_status",
    "estimator_states",
    "estimator_innovations",
    "ekf2_innovations",
)
# Bytes of the largest message (64 kB); pyulog creates a name per declared element before it reads the data.
MAX_ELEMENTS = 65_535
# Read budget: multiples of the file size, extra bytes, and the bytes charged per read. An intact file is read once.
MAX_READINGS, MAX_EXTRA, READ_COST = 20, 1_000_000, 20
LARGE_ARRAY = re.compile(rb"\w\[(\d{5,})\] ?\w")
MIN_FIX = 3
Columns = Mapping[str, Float[np.ndarray, " n"]]


def read_ulog(path: Path, name: str) -> FlightLog:
    """Return the flight in a ULog; InputFileError for one that pyulog cannot read, or that has no positions."""
    label = f"{name} {shown(path)}"
    regular_file(path, name, "give a ULog", MAX_BYTES)
    tables, corrupt = _tables(path, label)
    positions, on_map, notes = _positions(tables, label)
    notes = (*notes, *(("the file is damaged in places; what can be read is used",) if corrupt else ()))
    return FlightLog(
        kind="PX4 ULog",
        on_map=on_map,
        datum="mean sea level" if on_map else "take-off",
        positions=positions,
        attitudes=_attitudes(tables),
        spreads=_spreads(tables),
        sources=tuple(source_of(topic, table["timestamp"] * 1e-6) for topic, table in tables.items()),
        notes=notes,
    )


class _Patient(BytesIO):
    """A byte stream with a limited read budget: pyulog loops forever on some damaged files."""

    def __init__(self, content: bytes) -> None:
        super().__init__(content)
        self._left = MAX_READINGS * len(content) + MAX_EXTRA

    def read(self, size: int | None = -1, /) -> bytes:
        """Read bytes; RuntimeError once the budget is spent."""
        content = super().read(size)
        self._left -= len(content) + READ_COST
        if self._left < 0:
            raise RuntimeError("read over and over without an end")
        return content


def _tables(path: Path, label: str) -> tuple[dict[str, Columns], bool]:
    from pyulog import ULog

    try:
        content = path.read_bytes()
        oversized = [count for count in LARGE_ARRAY.findall(content) if int(count[:9]) > MAX_ELEMENTS]
        if oversized:
            count = shown(oversized[0].decode())
            message = f"{label}: declares an array of {count} elements, which no message holds; give a ULog of PX4"
            raise InputFileError(message)
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            log = ULog(_Patient(content), list(TOPICS))
    except InputFileError:
        raise
    except (Exception, RecursionError) as error:  # pyulog raises undocumented types
        reason = reason_of(error)
        raise InputFileError(f"{label} cannot be read as a ULog ({reason}); give one of PX4") from error
    tables: dict[str, Columns] = {}
    for data in sorted(log.data_list, key=lambda data: data.multi_id):
        if data.name not in tables and len(data.data.get("timestamp", ())):
            with np.errstate(invalid="ignore"):  # converting a damaged NaN warns
                tables[data.name] = {key: np.asarray(column, dtype=np.float64) for key, column in data.data.items()}
    return tables, bool(log.file_corruption)


def _positions(tables: Mapping[str, Columns], label: str) -> tuple[Positions, bool, tuple[str, ...]]:
    local = tables.get("vehicle_local_position")
    if local is not None and {"x", "y", "z"} <= set(local):
        local_positions = _local_positions(local)
        if local_positions is not None:
            return local_positions
    world = tables.get("vehicle_global_position")
    if world is not None and {"lat", "lon", "alt"} <= set(world):
        position = np.column_stack([world["lon"], world["lat"], world["alt"]])
        valid = np.isfinite(position).all(axis=1) & np.any(position[:, :2] != 0, axis=1)
        velocity = _velocity(world, ("vel_e", "vel_n", "vel_d"))
        return _of("vehicle_global_position", world, position, velocity, valid), True, ()
    gps = tables.get("vehicle_gps_position")
    if gps is not None and ({"lat", "lon", "alt"} <= set(gps) or "latitude_deg" in gps):
        return _receiver_positions(gps), True, ()
    raise InputFileError(f"{label}: has no positions ({', '.join(TOPICS[:3])}); give a log of a flight with a position")


def _times_s(table: Columns) -> Float[np.ndarray, " n"]:
    """Return the times of samples, or those of logging where they are not known."""
    time_us = table.get("timestamp_sample", table["timestamp"])
    return np.where(time_us > 0, time_us, table["timestamp"]) * 1e-6


def _of(
    source: str,
    table: Columns,
    position: Float[np.ndarray, "n 3"],
    velocity_mps: Float[np.ndarray, "n 3"] | None,
    valid: Bool[np.ndarray, " n"],
) -> Positions:
    return Positions(source=source, time_s=_times_s(table), place=position, velocity_mps=velocity_mps).rows(valid)


def _velocity(table: Columns, keys: tuple[str, str, str]) -> Float[np.ndarray, "n 3"] | None:
    if not set(keys) <= set(table):
        return None
    return np.column_stack([table[keys[0]], table[keys[1]], -table[keys[2]]])


def _receiver_positions(gps: Columns) -> Positions:
    if "latitude_deg" in gps:
        position = np.column_stack([gps["longitude_deg"], gps["latitude_deg"], gps["altitude_msl_m"]])
    else:
        position = np.column_stack([gps["lon"] * 1e-7, gps["lat"] * 1e-7, gps["alt"] * 1e-3])
    valid = np.isfinite(position).all(axis=1) & (gps.get("fix_type", np.full(len(position), MIN_FIX)) >= MIN_FIX)
    velocity = _velocity(gps, ("vel_e_m_s", "vel_n_m_s", "vel_d_m_s"))
    return _of("vehicle_gps_position", gps, position, velocity, valid)


def _local_positions(table: Columns) -> tuple[Positions, bool, tuple[str, ...]] | None:
    north, east, down, resets = _without_resets(table)
    everywhere = np.ones(len(north))
    valid = np.isfinite(north) & np.isfinite(east) & np.isfinite(down)
    valid &= (table.get("xy_valid", everywhere) > 0) & (table.get("z_valid", everywhere) > 0)
    lat, lon, height = (table.get(key, np.nan * everywhere) for key in ("ref_lat", "ref_lon", "ref_alt"))
    placed = (
        valid & np.isfinite(lat) & np.isfinite(lon) & np.isfinite(height) & (table.get("xy_global", everywhere) > 0)
    )
    placed &= (np.abs(lat) <= 90) & (np.abs(lon) <= 180)
    notes = (f"{resets} resets of the filter's position: what came before each is moved by it",) if resets else ()
    velocity = _velocity(table, ("vy", "vx", "vz"))
    source = "vehicle_local_position"
    if placed.sum() >= 2:
        # The inverse projection is the way along a great circle.
        azimuth_deg = np.rad2deg(np.arctan2(east, north))
        reached_lon, reached_lat, _ = SPHERE.fwd(lon, lat, azimuth_deg, np.hypot(north, east))
        degrees = np.column_stack([reached_lon, reached_lat, height - down])
        return _of(source, table, degrees, velocity, placed), True, notes
    if valid.sum() >= 2:
        note = "the log has no place on the map: its metres count from where the filter started"
        return _of(source, table, np.column_stack([east, north, -down]), velocity, valid), False, (*notes, note)
    return None


def _without_resets(
    table: Columns,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"], int]:
    """Return north, east and down, shifted by the later resets, and the number of resets."""
    axes = [table["x"].copy(), table["y"].copy(), table["z"].copy()]
    deltas = (("xy_reset_counter", "delta_xy[0]"), ("xy_reset_counter", "delta_xy[1]"), ("z_reset_counter", "delta_z"))
    # A new reference moves the origin; degrees already account for it.
    reference = table.get("ref_timestamp", np.zeros(len(axes[0])))
    resets: set[int] = set()
    for axis, (counter, delta) in zip(axes, deltas, strict=True):
        if counter not in table or delta not in table:
            continue
        changed = np.flatnonzero((np.diff(table[counter]) != 0) & (np.diff(reference) == 0)) + 1
        changed = changed[np.isfinite(table[delta][changed])]
        resets |= set(changed.tolist())
        step = np.zeros(len(axis))
        step[changed] = table[delta][changed]
        axis += np.sum(step) - np.cumsum(step)
    return axes[0], axes[1], axes[2], len(resets)


def _attitudes(tables: Mapping[str, Columns]) -> Attitudes | None:
    table = tables.get("vehicle_attitude")
    keys = [f"q[{i}]" for i in (1, 2, 3, 0)]  # PX4 has the scalar first
    if table is None or not set(keys) <= set(table):
        return None
    quaternion = np.column_stack([table[key] for key in keys])
    norm = np.linalg.norm(quaternion, axis=1)
    valid = np.isfinite(norm) & (np.abs(norm - 1) < 0.1)
    if not valid.any():
        return None
    unit = quaternion[valid] / norm[valid][:, None]
    return Attitudes(source="vehicle_attitude", time_s=_times_s(table)[valid], quaternion=unit)


def _spreads(tables: Mapping[str, Columns]) -> Spreads | None:
    """Return standard deviations from the filter's covariance, its stated accuracies, or else its innovations."""
    for topic in ("estimator_states", "estimator_status"):
        spreads = _covariances(topic, tables.get(topic))
        if spreads is not None:
            return spreads
    local = tables.get("vehicle_local_position", {})
    if {"eph", "epv"} <= set(local):
        across = local["eph"] / np.sqrt(2)  # a horizontal figure combines both axes
        position = np.column_stack([across, across, local["epv"]])
        speed = local.get("evh", np.nan * across) / np.sqrt(2)
        velocity = np.column_stack([speed, speed, local.get("evv", np.nan * across)])
        return spreads_of("eph, epv, evh, evv", local["timestamp"] * 1e-6, position, velocity)
    for topic, keys in (
        ("estimator_innovations", ("gps_hpos[1]", "gps_hpos[0]", "gps_vpos", "gps_hvel[1]", "gps_hvel[0]", "gps_vvel")),
        ("ekf2_innovations", tuple(f"vel_pos_innov[{i}]" for i in (4, 3, 5, 1, 0, 2))),
    ):
        table = tables.get(topic)
        if table is not None and set(keys) <= set(table):
            return innovations_of(topic, table["timestamp"] * 1e-6, table, keys)
    return None


def _covariances(topic: str, table: Columns | None) -> Spreads | None:
    """Return standard deviations from the diagonal of EKF2's covariance.

    Its states begin with the attitude (a quaternion of 4 in filters of 24 states, a rotation vector of 3 in those of
    23), then velocity and position, each north, east, down. The variances of a quaternion sum to a quarter of those of
    the rotation vector, which are taken as equal about all axes.
    """
    if table is None or "covariances[9]" not in table:
        return None
    count = float(np.median(table["n_states"])) if "n_states" in table else 24.0
    if count not in (23.0, 24.0):
        return None
    attitude_states = 4 if count == 24 else 3
    variance = np.column_stack([table[f"covariances[{i}]"] for i in range(attitude_states + 6)])
    if not np.isfinite(variance).all() or np.any(variance < 0) or not np.any(variance[:, attitude_states:] > 0):
        return None
    turn = variance[:, :attitude_states].sum(axis=1) * (4.0 if attitude_states == 4 else 1.0) / 3
    velocity, position = (
        variance[:, attitude_states : attitude_states + 3],
        variance[:, attitude_states + 3 : attitude_states + 6],
    )
    to_east = [1, 0, 2]
    return spreads_of(
        f"{topic} covariances",
        table["timestamp"] * 1e-6,
        np.sqrt(position[:, to_east]),
        np.sqrt(velocity[:, to_east]),
        np.sqrt(np.tile(turn[:, None], (1, 3))),
    )
