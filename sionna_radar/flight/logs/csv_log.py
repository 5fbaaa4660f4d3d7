"""Flights as CSV with a header.

`time_s`; `east_m,north_m,up_m` (local metres) or `lon_deg,lat_deg,height_m` (WGS 84); attitude, if any, as
`roll_deg,pitch_deg,heading_deg` or as the quaternion `qw,qx,qy,qz` from body (nose, right, down) to north, east, down;
`velocity_east_mps,velocity_north_mps,velocity_up_mps`; and standard deviations `sigma_east_m`, `sigma_north_m`,
`sigma_up_m`, `sigma_velocity_east_mps`, ..., `sigma_roll_deg`, `sigma_pitch_deg`, `sigma_heading_deg`. An empty cell,
or nan, has no value: streams of different rates share a file so. North is grid north for metres, and true north for
longitude and latitude.
"""

import csv
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from sionna_radar.flight.logs.log import Attitudes, FlightLog, Positions, Spreads, source_of, spreads_of
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import shown

METRES = ("east_m", "north_m", "up_m")
DEGREES = ("lon_deg", "lat_deg", "height_m")
EULER = ("roll_deg", "pitch_deg", "heading_deg")
QUATERNION = ("qx", "qy", "qz", "qw")
VELOCITY = ("velocity_east_mps", "velocity_north_mps", "velocity_up_mps")
SIGMAS = (
    ("sigma_east_m", "sigma_north_m", "sigma_up_m"),
    ("sigma_velocity_east_mps", "sigma_velocity_north_mps", "sigma_velocity_up_mps"),
    ("sigma_roll_deg", "sigma_pitch_deg", "sigma_heading_deg"),
)
KNOWN = {"time_s", *METRES, *DEGREES, *EULER, *QUATERNION, *VELOCITY, *(name for group in SIGMAS for name in group)}
MOST_ROWS = 3_000_000
LONGEST_LINE = 100_000


def read_csv(path: Path, name: str) -> FlightLog:
    """Return the flight in a CSV file.

    Raises InputFileError, with the line, for a header without time and position, and for a cell that is no number.
    """
    columns, notes = _columns(path, name)
    time_s = columns["time_s"]
    on_map = all(key in columns for key in DEGREES)
    place = DEGREES if on_map else METRES
    positions = Positions(
        source=",".join(place),
        time_s=time_s,
        place=_stacked(columns, place),
        velocity_mps=_stacked(columns, VELOCITY) if VELOCITY[0] in columns else None,
    )
    positions = positions.rows(np.isfinite(positions.place).any(axis=1))
    if positions.velocity_mps is not None and not np.isfinite(positions.velocity_mps).all():
        # Rows of a slower stream: the spline through the positions knows better than half of the velocities.
        notes = (*notes, "velocities are missing in some rows, and those of the positions' spline are used")
        positions = Positions(source=positions.source, time_s=positions.time_s, place=positions.place)
    attitudes = _attitudes(columns)
    spreads = _spreads(columns)
    found: list[Positions | Attitudes | Spreads] = [positions]
    found += [stream for stream in (attitudes, spreads) if stream is not None]
    return FlightLog(
        kind="CSV",
        on_map=on_map,
        datum="unknown",
        positions=positions,
        attitudes=attitudes,
        spreads=spreads,
        sources=tuple(source_of(stream.source, stream.time_s) for stream in found),
        notes=notes,
    )


def _columns(path: Path, name: str) -> tuple[dict[str, Float[np.ndarray, " n"]], tuple[str, ...]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = csv.reader(_lines(file, f"{name} {shown(path)}"), strict=True)
            header = [cell.strip() for cell in next(rows, [])]
            _check_header(header, f"{name} {shown(path)}")
            return _numbers(header, rows, f"{name} {shown(path)}")
    except (UnicodeDecodeError, csv.Error, OSError) as error:
        message = f"{name} {shown(path)} is not CSV ({str(error)[:100]}); save it in UTF-8, with commas and a header"
        raise InputFileError(message) from error


def _lines(file: Iterator[str], where: str) -> Iterator[str]:
    for number, line in enumerate(file, start=1):
        if len(line) > LONGEST_LINE:
            message = f"{where}: line {number} has {len(line):,} characters; give one row of numbers a line"
            raise InputFileError(message)
        yield line


def _check_header(header: Sequence[str], where: str) -> None:
    doubled = sorted({key for key in header if key in KNOWN and header.count(key) > 1})
    complete = [group for group in (METRES, DEGREES) if set(group) <= set(header)]
    if "time_s" not in header or not complete:
        wanted = f"time_s with {','.join(METRES)} or {','.join(DEGREES)}"
        message = f"{where}: line 1 {shown(','.join(header))} is no header of a flight; give {wanted}"
    elif doubled:
        message = f"{where}: line 1 has {doubled[0]} twice; remove one"
    elif len(complete) > 1:
        message = f"{where}: line 1 has positions in metres and in degrees; remove one of them"
    else:
        for group in (EULER, QUATERNION, VELOCITY, *SIGMAS):
            missing = [key for key in group if key not in header]
            if missing and len(missing) < len(group):
                message = f"{where}: line 1 has {', '.join(group)} only in part; add {', '.join(missing)}"
                break
        else:
            return
    raise InputFileError(message)


def _numbers(
    header: Sequence[str], rows: Iterator[list[str]], where: str
) -> tuple[dict[str, Float[np.ndarray, " n"]], tuple[str, ...]]:
    used = [(place, key) for place, key in enumerate(header) if key in KNOWN]
    found = {key: array("d") for _, key in used}
    for count, row in enumerate(rows):
        if not row or not any(cell.strip() for cell in row):
            continue
        if count >= MOST_ROWS:
            message = f"{where}: has more than {MOST_ROWS:,} rows; thin it, or cut it"
            raise InputFileError(message)
        if len(row) != len(header):
            message = f"{where}: line {count + 2} has {len(row)} cells and the header {len(header)}; correct the line"
            raise InputFileError(message)
        for place, key in used:
            found[key].append(_number(row[place], key, f"{where}: line {count + 2}"))
    unused = [key for key in header if key not in KNOWN]
    notes = (f"columns not used: {shown(', '.join(unused))[1:-1]}",) if unused else ()
    return {key: np.array(values) for key, values in found.items()}, notes


def _number(cell: str, key: str, where: str) -> float:
    text = cell.strip()
    if not text:
        return np.nan
    try:
        value = float(text)
    except ValueError:
        value = np.inf
    if np.isinf(value) or abs(value) > 1e15:
        message = f"{where}: {key} = {shown(text)} is no number; correct it, or leave the cell empty"
        raise InputFileError(message)
    return value


def _stacked(columns: dict[str, Float[np.ndarray, " n"]], keys: Sequence[str]) -> Float[np.ndarray, "n k"]:
    return np.column_stack([columns[key] for key in keys])


def _attitudes(columns: dict[str, Float[np.ndarray, " n"]]) -> Attitudes | None:
    if QUATERNION[0] in columns:
        quaternion = _stacked(columns, QUATERNION)
        with np.errstate(invalid="ignore"):
            known = np.isfinite(quaternion).all(axis=1) & (np.linalg.norm(quaternion, axis=1) > 0.5)
        unit = quaternion[known] / np.linalg.norm(quaternion[known], axis=1)[:, None]
        return Attitudes(source=",".join(QUATERNION), time_s=columns["time_s"][known], quaternion=unit)
    if EULER[0] in columns:
        euler = _stacked(columns, EULER)
        known = np.isfinite(euler).all(axis=1)
        turned = Rotation.from_euler("ZYX", euler[known][:, ::-1], degrees=True).as_quat() if known.any() else None
        if turned is not None:
            return Attitudes(source=",".join(EULER), time_s=columns["time_s"][known], quaternion=turned)
    return None


def _spreads(columns: dict[str, Float[np.ndarray, " n"]]) -> Spreads | None:
    groups = [_stacked(columns, keys) if keys[0] in columns else None for keys in SIGMAS]
    if all(group is None for group in groups):
        return None
    position, velocity, attitude = groups
    radians = None if attitude is None else np.deg2rad(attitude)
    spreads = spreads_of("sigma columns", columns["time_s"], position, velocity, radians)
    known = np.isfinite(np.column_stack([spreads.position_m, spreads.velocity_mps, spreads.attitude_rad])).any(axis=1)
    return spreads.rows(known)
