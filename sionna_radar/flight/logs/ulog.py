"""PX4's ULog, read by pyulog.

`vehicle_local_position` is north, east, down about a reference that PX4 places on the map by an azimuthal equidistant
projection on a sphere (its MapProjection, src/lib/geo/geo.cpp), which is undone here; without a reference the flight is
in local metres. Where the filter resets its position it logs by how much, and what came before is moved by it.
"""

import re
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.flight.logs.log import Attitudes, FlightLog, Positions, Spreads, running_rms, source_of, spreads_of
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import regular_file, shown

MAX_BYTES = 1_000_000_000
# Of the sphere that PX4 projects on (CONSTANTS_RADIUS_OF_EARTH).
EARTH_RADIUS_M = 6_371_000.0
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
# More elements than a message of 64 kB has bytes; pyulog names each of them before it looks at the data.
MAX_ELEMENTS = 65_535
# A sound file is read once; a read costs as much as some bytes.
MAX_READINGS, MAX_EXTRA, READ_COST = 20, 1_000_000, 20
LARGE_ARRAY = re.compile(rb"\w\[(\d{5,})\] ?\w")
MIN_FIX = 3
Columns = Mapping[str, Float[np.ndarray, " n"]]


def read_ulog(path: Path, name: str) -> FlightLog:
    """Return the flight in a ULog.

    Raises InputFileError for a file that pyulog cannot read, and for one without positions.
    """
    where = f"{name} {shown(path)}"
    regular_file(path, name, "give a ULog", MAX_BYTES)
    tables, corrupt = _tables(path, where)
    positions, on_map, notes = _positions(tables, where)
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
    """Bytes that are read a few times over, and no more: pyulog goes back in some damaged files for ever."""

    def __init__(self, content: bytes) -> None:
        super().__init__(content)
        self._left = MAX_READINGS * len(content) + MAX_EXTRA

    def read(self, size: int | None = -1, /) -> bytes:
        """Return some of the bytes; RuntimeError once they have been read too often."""
        found = super().read(size)
        self._left -= len(found) + READ_COST
        if self._left < 0:
            message = "read over and over without an end"
            raise RuntimeError(message)
        return found


def _tables(path: Path, where: str) -> tuple[dict[str, Columns], bool]:
    from pyulog import ULog

    try:
        content = path.read_bytes()
        large = [count for count in LARGE_ARRAY.findall(content) if int(count[:9]) > MAX_ELEMENTS]
        if large:
            count = shown(large[0].decode())
            message = f"{where}: declares an array of {count} elements, which no message holds; give a ULog of PX4"
            raise InputFileError(message)
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            log = ULog(_Patient(content), list(TOPICS))
    except InputFileError:
        raise
    except (Exception, RecursionError) as error:  # pyulog raises whatever its parsing comes upon
        message = f"{where} cannot be read as a ULog ({type(error).__name__}: {str(error)[:100]}); give one of PX4"
        raise InputFileError(message) from error
    tables: dict[str, Columns] = {}
    for data in sorted(log.data_list, key=lambda data: data.multi_id):
        if data.name not in tables and len(data.data.get("timestamp", ())):
            with np.errstate(invalid="ignore"):  # a damaged NaN says so when it is converted
                tables[data.name] = {key: np.asarray(column, dtype=np.float64) for key, column in data.data.items()}
    return tables, bool(log.file_corruption)


def _positions(tables: Mapping[str, Columns], where: str) -> tuple[Positions, bool, tuple[str, ...]]:
    local = tables.get("vehicle_local_position")
    if local is not None and {"x", "y", "z"} <= set(local):
        found = _local_positions(local)
        if found is not None:
            return found
    world = tables.get("vehicle_global_position")
    if world is not None and {"lat", "lon", "alt"} <= set(world):
        place = np.column_stack([world["lon"], world["lat"], world["alt"]])
        valid = np.isfinite(place).all(axis=1) & np.any(place[:, :2] != 0, axis=1)
        velocity = _velocity(world, ("vel_e", "vel_n", "vel_d"))
        return _of("vehicle_global_position", world, place, velocity, valid), True, ()
    gps = tables.get("vehicle_gps_position")
    if gps is not None and ({"lat", "lon", "alt"} <= set(gps) or "latitude_deg" in gps):
        return _receiver_positions(gps), True, ()
    message = f"{where}: has no positions ({', '.join(TOPICS[:3])}); give a log of a flight with a position"
    raise InputFileError(message)


def _of(
    source: str,
    table: Columns,
    place: Float[np.ndarray, "n 3"],
    velocity_mps: Float[np.ndarray, "n 3"] | None,
    valid: Bool[np.ndarray, " n"],
) -> Positions:
    time_s = table.get("timestamp_sample", table["timestamp"])
    time_s = np.where(time_s > 0, time_s, table["timestamp"]) * 1e-6
    return Positions(source=source, time_s=time_s, place=place, velocity_mps=velocity_mps).rows(valid)


def _velocity(table: Columns, keys: tuple[str, str, str]) -> Float[np.ndarray, "n 3"] | None:
    """Return velocities from columns of east, north and down."""
    if not set(keys) <= set(table):
        return None
    return np.column_stack([table[keys[0]], table[keys[1]], -table[keys[2]]])


def _receiver_positions(gps: Columns) -> Positions:
    if "latitude_deg" in gps:
        place = np.column_stack([gps["longitude_deg"], gps["latitude_deg"], gps["altitude_msl_m"]])
    else:
        place = np.column_stack([gps["lon"] * 1e-7, gps["lat"] * 1e-7, gps["alt"] * 1e-3])
    valid = np.isfinite(place).all(axis=1) & (gps.get("fix_type", np.full(len(place), MIN_FIX)) >= MIN_FIX)
    velocity = _velocity(gps, ("vel_e_m_s", "vel_n_m_s", "vel_d_m_s"))
    return _of("vehicle_gps_position", gps, place, velocity, valid)


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
        degrees = np.column_stack([*_on_the_map(north, east, lat, lon), height - down])
        return _of(source, table, degrees, velocity, placed), True, notes
    if valid.sum() >= 2:
        note = "the log has no place on the map: its metres count from where the filter started"
        return _of(source, table, np.column_stack([east, north, -down]), velocity, valid), False, (*notes, note)
    return None


def _without_resets(
    table: Columns,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"], int]:
    """Return north, east and down with what came before a reset moved by it, and how many resets there were."""
    axes = [table["x"].copy(), table["y"].copy(), table["z"].copy()]
    deltas = (("xy_reset_counter", "delta_xy[0]"), ("xy_reset_counter", "delta_xy[1]"), ("z_reset_counter", "delta_z"))
    # A new reference moves the origin; degrees know it already.
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


def _on_the_map(
    north: Float[np.ndarray, " n"],
    east: Float[np.ndarray, " n"],
    lat: Float[np.ndarray, " n"],
    lon: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return longitude and latitude in degrees: the inverse azimuthal equidistant projection on PX4's sphere."""
    x, y = north / EARTH_RADIUS_M, east / EARTH_RADIUS_M
    angle = np.hypot(x, y)
    sine = np.sinc(angle / np.pi)  # sin(angle) / angle
    phi = np.deg2rad(lat)
    latitude = np.arcsin(np.clip(np.cos(angle) * np.sin(phi) + x * sine * np.cos(phi), -1.0, 1.0))
    longitude = np.deg2rad(lon) + np.arctan2(y * sine, np.cos(phi) * np.cos(angle) - x * np.sin(phi) * sine)
    return np.rad2deg(longitude), np.rad2deg(latitude)


def _attitudes(tables: Mapping[str, Columns]) -> Attitudes | None:
    table = tables.get("vehicle_attitude")
    keys = [f"q[{i}]" for i in (1, 2, 3, 0)]  # PX4 has the scalar first
    if table is None or not set(keys) <= set(table):
        return None
    quaternion = np.column_stack([table[key] for key in keys])
    size = np.linalg.norm(quaternion, axis=1)
    known = np.isfinite(size) & (np.abs(size - 1) < 0.1)
    time_s = table.get("timestamp_sample", table["timestamp"])
    time_s = np.where(time_s > 0, time_s, table["timestamp"])[known] * 1e-6
    return (
        Attitudes(source="vehicle_attitude", time_s=time_s, quaternion=quaternion[known] / size[known][:, None])
        if known.any()
        else None
    )


def _spreads(tables: Mapping[str, Columns]) -> Spreads | None:
    """Return the standard deviations of the filter's covariance; else what it states; else its innovations."""
    for topic in ("estimator_states", "estimator_status"):
        found = _covariances(topic, tables.get(topic))
        if found is not None:
            return found
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
            time_s = table["timestamp"] * 1e-6
            size = [running_rms(time_s, np.column_stack([table[k] for k in group])) for group in (keys[:3], keys[3:])]
            return spreads_of(f"{topic}", time_s, *size)
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
    first = 4 if count == 24 else 3
    variance = np.column_stack([table[f"covariances[{i}]"] for i in range(first + 6)])
    if not np.isfinite(variance).all() or np.any(variance < 0) or not np.any(variance[:, first:] > 0):
        return None
    turn = variance[:, :first].sum(axis=1) * (4.0 if first == 4 else 1.0) / 3
    velocity, position = variance[:, first : first + 3], variance[:, first + 3 : first + 6]
    to_east = [1, 0, 2]
    return spreads_of(
        f"{topic} covariances",
        table["timestamp"] * 1e-6,
        np.sqrt(position[:, to_east]),
        np.sqrt(velocity[:, to_east]),
        np.sqrt(np.tile(turn[:, None], (1, 3))),
    )
