"""Flights as CSV with a header.

`time_s`; `east_m,north_m,up_m` (local metres), `lon_deg,lat_deg,height_m` (WGS 84), or `easting_m,northing_m,
elevation_m` in the CRS of `platform.log_crs`, as `trajectory.csv` of a survey has them; attitude, if any, as
`roll_deg,pitch_deg,heading_deg` or as the quaternion `qw,qx,qy,qz` from body (nose, right, down) to north, east, down;
`velocity_east_mps,velocity_north_mps,velocity_up_mps`; and standard deviations `sigma_east_m`, `sigma_north_m`,
`sigma_up_m`, `sigma_velocity_east_mps`, ..., `sigma_roll_deg`, `sigma_pitch_deg`, `sigma_heading_deg`. Empty cells and
nan are missing values, so that streams of different rates can share a file. North is grid north for metres, of any
CRS, and true north for longitude and latitude.

Other column names are matched by `ALIASES`, those of common ground stations, or by `platform.log_columns`. The
delimiter (comma, semicolon or tab) is that of the header; a comma within a number is a decimal one. Times are seconds,
or ISO 8601 dates; a name that ends in (millisecond), (ms), (feet), (ft), (rad) or _rad has that unit. Lines that begin
with # are comments; the header may be the last of them, as in HELIOS++'s `.trj`.
"""

import csv
from array import array
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.log import Attitudes, FlightLog, Positions, Spreads, attitudes_of, source_of, spreads_of
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import shown
from sionna_radar.readers.logs.map_coordinates import MapCoordinates

METRES = ("east_m", "north_m", "up_m")
DEGREES = ("lon_deg", "lat_deg", "height_m")
PROJECTED = ("easting_m", "northing_m", "elevation_m")
EULER = ("roll_deg", "pitch_deg", "heading_deg")
QUATERNION = ("qx", "qy", "qz", "qw")
VELOCITY = ("velocity_east_mps", "velocity_north_mps", "velocity_up_mps")
SIGMAS = (
    ("sigma_east_m", "sigma_north_m", "sigma_up_m"),
    ("sigma_velocity_east_mps", "sigma_velocity_north_mps", "sigma_velocity_up_mps"),
    ("sigma_roll_deg", "sigma_pitch_deg", "sigma_heading_deg"),
)
KNOWN = {"time_s", *chain(METRES, DEGREES, PROJECTED, EULER, QUATERNION, VELOCITY, *SIGMAS)}
# Lower-case names in order of preference: AirData UAV's, QGroundControl's, and plain words.
ALIASES = {
    "time_s": ("time(millisecond)", "timestamp", "datetime(utc)", "datetime", "time", "gps_time", "gpstime", "t"),
    "lon_deg": ("longitude", "gps.lon", "lon", "lng"),
    "lat_deg": ("latitude", "gps.lat", "lat"),
    "height_m": (
        "altitude_above_sealevel(meters)",
        "altitude_above_sealevel(feet)",
        "altitudeamsl",
        "altitude(m)",
        "altitude",
        "alt",
    ),
    "roll_deg": ("roll(degrees)", "roll", "roll_rad", "roll(rad)"),
    "pitch_deg": ("pitch(degrees)", "pitch", "pitch_rad", "pitch(rad)"),
    "heading_deg": ("compass_heading(degrees)", "heading", "yaw", "heading_rad", "yaw_rad", "heading(rad)", "yaw(rad)"),
}
# The same of map coordinates, where `platform.log_crs` is given.
PROJECTED_ALIASES = {
    "easting_m": ("easting", "x", "x_m"),
    "northing_m": ("northing", "y", "y_m"),
    "elevation_m": ("elevation", "z", "z_m", "height", "height_m", "altitude"),
}
DEGREES_A_RADIAN = float(np.rad2deg(1.0))
UNITS = {
    **{"(millisecond)": 1e-3, "(ms)": 1e-3, "(feet)": 0.3048, "(ft)": 0.3048},
    **{"(rad)": DEGREES_A_RADIAN, "_rad": DEGREES_A_RADIAN},
}
# Map coordinates by our names and the first of others.
MAP_NAMES = tuple((key, *names[:2]) for key, names in PROJECTED_ALIASES.items())
HEADER_WORD = "HEADER:"
# Seconds since 1970 have ten digits; more are milliseconds.
MAX_SECONDS = 1e11
# Columns that a note names.
MAX_LISTED = 12
NOTHING = {"", "nan", "--", "--.--", "n/a", "null"}
MAX_ROWS = 3_000_000
LONGEST_LINE = 100_000
DELIMITERS = (",", ";", "\t")
AS_THEY_ARE: Mapping[str, str] = MappingProxyType({})


def read_csv(
    path: Path, name: str, named: Mapping[str, str] = AS_THEY_ARE, crs: MapCoordinates | None = None
) -> FlightLog:
    """Return the flight in a CSV file; `crs` is that of its map coordinates, which are read then.

    named: its columns by our names.
    Raises InputFileError, with the line, for a header without time and position, for a name missing from the header,
    and for a cell that is not a number.
    """
    columns, notes = _columns(path, name, named, on_map=crs is not None)
    time_s = columns["time_s"]
    on_map = crs is None and all(key in columns for key in DEGREES)
    keys = PROJECTED if crs is not None else DEGREES if on_map else METRES
    positions = Positions(
        source=",".join(keys),
        time_s=time_s,
        place=_stacked(columns, keys),
        velocity_mps=_stacked(columns, VELOCITY) if VELOCITY[0] in columns else None,
    )
    positions = positions.rows(np.isfinite(positions.place).any(axis=1))
    if positions.velocity_mps is not None and not np.isfinite(positions.velocity_mps).all():
        # Rows of a slower stream: the derivative of the position spline is more accurate than interpolated velocities.
        notes = (*notes, "velocities are missing in some rows, and those of the positions' spline are used")
        positions = Positions(source=positions.source, time_s=positions.time_s, place=positions.place)
    attitudes = _attitudes(columns)
    spreads = _spreads(columns)
    streams: list[Positions | Attitudes | Spreads] = [positions]
    streams += [stream for stream in (attitudes, spreads) if stream is not None]
    log = FlightLog(
        kind="CSV",
        on_map=on_map,
        datum="unknown",
        positions=positions,
        attitudes=attitudes,
        spreads=spreads,
        sources=tuple(source_of(stream.source, stream.time_s) for stream in streams),
        notes=notes,
    )
    return log if crs is None else crs.on_the_globe(log)


def _listed(texts: Sequence[str]) -> str:
    more = len(texts) - MAX_LISTED
    return ", ".join(texts[:MAX_LISTED]) + (f" and {more} more" if more > 0 else "")


def _columns(
    path: Path, name: str, column_names: Mapping[str, str], *, on_map: bool
) -> tuple[dict[str, Float[np.ndarray, " n"]], tuple[str, ...]]:
    label = f"{name} {shown(path)}"
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = _lines(file, label)
            number, header_line, lines = _header_line(lines)
            delimiter = max(DELIMITERS, key=header_line.count)
            (cells,) = csv.reader([header_line], strict=True, delimiter=delimiter, skipinitialspace=True)
            rows = csv.reader(lines, strict=True, delimiter=delimiter)
            cells = [cell.strip() for cell in cells]
            header = _renamed(cells, column_names, f"{label}: line {number} {shown(header_line.strip())}", on_map)
            _check_header(header, f"{label}: line {number} {shown(header_line.strip())}", on_map)
            columns, notes = _numbers(header, rows, label, [_unit(cell) for cell in cells], delimiter != ",", number)
            changed = [
                f"{shown(cell)} as {key}" for cell, key in zip(cells, header, strict=True) if key and cell != key
            ]
            return columns, (*notes, *([f"columns read: {_listed(changed)}"] if changed else []))
    except (UnicodeDecodeError, csv.Error, OSError) as error:
        message = f"{name} {shown(path)} is not CSV ({str(error)[:100]}); save it in UTF-8, with a header"
        raise InputFileError(message) from error


def _lines(file: Iterator[str], label: str) -> Iterator[str]:
    for number, line in enumerate(file, start=1):
        if len(line) > LONGEST_LINE:
            raise InputFileError(f"{label}: line {number} has {len(line):,} characters; give one row of numbers a line")
        yield line


def _header_line(lines: Iterator[str]) -> tuple[int, str, Iterator[str]]:
    """Return number and text of the header, and the lines after it.

    The header is the first line that is no comment; or the last comment with columns before a first row of numbers, as
    NumPy and HELIOS++ write it.
    """
    comment: tuple[int, str] | None = None
    for number, line in enumerate(lines, start=1):
        if not line.startswith("#"):
            if comment and _number_or_none(line.split(max(DELIMITERS, key=line.count))[0]) is not None:
                return comment[0], comment[1], chain([line], lines)
            return number, line, lines
        text = line.lstrip("#").strip()
        text = text[len(HEADER_WORD) :] if text.upper().startswith(HEADER_WORD) else text
        if any(delimiter in text for delimiter in DELIMITERS):
            comment = number, text
    return 1, "", lines


def _number_or_none(text: str) -> float | None:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return None


def _renamed(header: Sequence[str], column_names: Mapping[str, str], label: str, on_map: bool) -> list[str]:
    """Return a header with our names in place of configured names and aliases."""
    for key, column in column_names.items():
        if key not in KNOWN:
            message = f"platform.log_columns: {key} is no column of a flight; give one of {', '.join(sorted(KNOWN))}"
            raise InputFileError(message)
        if column not in header:
            raise InputFileError(f"{label}: has no column {shown(column)}, which platform.log_columns.{key} names")
    keys = {column: key for key, column in column_names.items()}
    renamed = [keys.get(cell, "" if cell in column_names else cell) for cell in header]
    lower = [cell.lower() for cell in renamed]
    aliases = ALIASES | PROJECTED_ALIASES if on_map else ALIASES
    matches = {
        key: next((lower.index(alias) for alias in names if alias in lower), None)
        for key, names in aliases.items()
        if key not in renamed
    }
    if on_map or "east_m" in renamed:
        matches = {key: column_index for key, column_index in matches.items() if key not in DEGREES}
    if "qw" in renamed or not all(key in renamed or matches.get(key) is not None for key in EULER):
        matches = {key: column_index for key, column_index in matches.items() if key not in EULER}
    for key, column_index in matches.items():
        if column_index is not None:
            renamed[column_index] = key
    return renamed


def _unit(column: str) -> float:
    return next((unit for end, unit in UNITS.items() if column.lower().endswith(end)), 1.0)


def _check_header(header: Sequence[str], label: str, on_map: bool) -> None:
    """Raise InputFileError for a header without time and positions, or with too many or too few columns."""
    doubled = sorted({key for key in header if key in KNOWN and header.count(key) > 1})
    complete = [group for group in ((PROJECTED,) if on_map else (METRES, DEGREES)) if set(group) <= set(header)]
    lower = {cell.lower() for cell in header}
    if "time_s" not in header or not complete:
        places = ",".join(PROJECTED) if on_map else f"{','.join(METRES)} or {','.join(DEGREES)}"
        message = f"{label}: unrecognised CSV header; give time_s with {places}, or say by platform.log_columns which "
        message += "column is which (for the command log in the scenario of --over)"
        if not on_map and any({*names} <= lower for names in zip(*MAP_NAMES, strict=True)):
            message += "; map coordinates need their CRS, platform.log_crs (--crs of the command log)"
    elif doubled:
        message = f"{label}: has {doubled[0]} twice; remove one"
    elif len(complete) > 1:
        message = f"{label}: has positions in metres and in degrees; remove one of them"
    else:
        for group in (EULER, QUATERNION, VELOCITY, *SIGMAS):
            missing = [key for key in group if key not in header]
            if missing and len(missing) < len(group):
                message = f"{label}: has {', '.join(group)} only in part; add {', '.join(missing)}"
                break
        else:
            return
    raise InputFileError(message)


def _numbers(
    header: Sequence[str],
    rows: Iterator[list[str]],
    label: str,
    unit: Sequence[float],
    decimal_comma: bool,
    header_number: int,
) -> tuple[dict[str, Float[np.ndarray, " n"]], tuple[str, ...]]:
    fields = [(column_index, key) for column_index, key in enumerate(header) if key in KNOWN]
    cells = {key: array("d") for _, key in fields}
    for count, row in enumerate(rows):
        if not row or not any(cell.strip() for cell in row):
            continue
        if count >= MAX_ROWS:
            raise InputFileError(f"{label}: has more than {MAX_ROWS:,} rows; thin it, or cut it")
        if len(row) != len(header):
            number = header_number + count + 1
            message = f"{label}: line {number} has {len(row)} cells and the header {len(header)}; correct the line"
            raise InputFileError(message)
        for column_index, key in fields:
            cell = row[column_index].replace(",", ".") if decimal_comma else row[column_index]
            cells[key].append(_number(cell, key, f"{label}: line {header_number + count + 1}") * unit[column_index])
    unused = [key for key in header if key not in KNOWN]
    notes = (f"columns not used: {_listed([shown(key) for key in unused])}",) if unused else ()
    columns = {key: np.array(values) for key, values in cells.items()}
    if np.nanmax(np.abs(columns["time_s"]), initial=0.0) > MAX_SECONDS:
        columns["time_s"] /= 1000.0
        notes = (*notes, "times since 1970 are taken for milliseconds")
    return columns, notes


def _number(cell: str, key: str, label: str) -> float:
    text = cell.strip()
    if text.lower() in NOTHING:
        return np.nan
    try:
        value = float(text)
    except ValueError:
        value = _seconds(text) if key == "time_s" else np.inf
    if np.isinf(value) or abs(value) > 1e15:
        raise InputFileError(f"{label}: {key} = {shown(text)} is no number; correct it, or leave the cell empty")
    return value


def _seconds(text: str) -> float:
    """Return the seconds since 1970 of a date, UTC unless it has a zone; infinite for anything else."""
    try:
        date = datetime.fromisoformat(text)
    except ValueError:
        return np.inf
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def _stacked(columns: dict[str, Float[np.ndarray, " n"]], keys: Sequence[str]) -> Float[np.ndarray, "n k"]:
    return np.column_stack([columns[key] for key in keys])


def _attitudes(columns: dict[str, Float[np.ndarray, " n"]]) -> Attitudes | None:
    if QUATERNION[0] in columns:
        quaternion = _stacked(columns, QUATERNION)
        with np.errstate(invalid="ignore"):
            finite = np.isfinite(quaternion).all(axis=1) & (np.linalg.norm(quaternion, axis=1) > 0.5)
        unit = quaternion[finite] / np.linalg.norm(quaternion[finite], axis=1)[:, None]
        return Attitudes(source=",".join(QUATERNION), time_s=columns["time_s"][finite], quaternion=unit)
    if EULER[0] in columns:
        return attitudes_of(",".join(EULER), columns["time_s"], _stacked(columns, EULER)[:, ::-1], degrees=True)
    return None


def _spreads(columns: dict[str, Float[np.ndarray, " n"]]) -> Spreads | None:
    groups = [_stacked(columns, keys) if keys[0] in columns else None for keys in SIGMAS]
    if all(group is None for group in groups):
        return None
    position, velocity, attitude = groups
    radians = None if attitude is None else np.deg2rad(attitude)
    spreads = spreads_of("sigma columns", columns["time_s"], position, velocity, radians)
    finite = np.isfinite(np.column_stack([spreads.position_m, spreads.velocity_mps, spreads.attitude_rad])).any(axis=1)
    return spreads.rows(finite)
