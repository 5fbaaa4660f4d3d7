"""Reading of a flight log of any known format, detected from its first bytes, or from its suffix (SBET, CSV).

GPX tracks are read here.

A GPX track holds longitude, latitude, elevation and time, and nothing else. The standard defines the elevation only as
"elevation in metres"; receivers write heights above mean sea level, which is assumed.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from sionna_radar.flight.log import FlightLog, Positions, source_of
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import readable, regular_file, shown
from sionna_radar.readers.logs.csv_log import AS_THEY_ARE, read_csv
from sionna_radar.readers.logs.dataflash import MAGIC, read_dataflash
from sionna_radar.readers.logs.map_coordinates import map_coordinates
from sionna_radar.readers.logs.sbet import SUFFIXES as SBET_SUFFIXES
from sionna_radar.readers.logs.sbet import read_sbet
from sionna_radar.readers.logs.telemetry import V1, V2, read_telemetry
from sionna_radar.readers.logs.ulog import read_ulog

GPX_MAX_BYTES = 50_000_000


def read_gpx(path: Path, name: str) -> FlightLog:
    """Return the flight in all tracks of a GPX file; InputFileError for other XML, entities, no times or heights."""
    label = f"{name} {shown(path)}"
    regular_file(path, name, "give a GPX track", GPX_MAX_BYTES)
    points = [point for track in _parsed(path, label).tracks for segment in track.segments for point in segment.points]
    if len(points) < 2:
        message = f"{label}: holds {len(points)} points of a track; give a recorded track, not a route or waypoints"
        raise InputFileError(message)
    for number, point in enumerate(points):
        if point.time is None:
            raise InputFileError(f"{label}: point {number + 1} of the track has no time; give a recorded track")
        if point.elevation is None:
            message = f"{label}: point {number + 1} of the track has no elevation; add <ele>, or drop the point"
            raise InputFileError(message)
    start_time = points[0].time
    try:
        time_s = np.array([(point.time - start_time).total_seconds() for point in points])
    except TypeError as error:
        raise InputFileError(f"{label}: some times have a zone and some have none; write all of them alike") from error
    position = np.array([[point.longitude, point.latitude, point.elevation] for point in points], dtype=float)
    return FlightLog(
        kind="GPX",
        on_map=True,
        datum="mean sea level",
        positions=Positions(source="trkpt", time_s=time_s, place=position),
        attitudes=None,
        spreads=None,
        sources=(source_of("trkpt", time_s),),
        notes=("elevations of GPX are taken as heights above mean sea level",),
    )


def _parsed(path: Path, label: str) -> Any:
    import gpxpy
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        content = path.read_bytes()
        # gpxpy expands entities, depending on the installed parser: reject them first.
        fromstring(content, forbid_dtd=True)
        with suppress(UnicodeDecodeError):  # of another encoding, which the file declares
            return gpxpy.parse(content.decode("utf-8-sig"))
        return gpxpy.parse(content)
    except DefusedXmlException as error:
        message = f"{label}: declares entities or a document type, which GPX does not need; remove them"
        raise InputFileError(message) from error
    except InputFileError:
        raise
    except (Exception, RecursionError) as error:  # gpxpy and the XML parsers raise undocumented types
        raise InputFileError(f"{label} is not GPX ({str(error)[:100]}); give a GPX track") from error


MAX_BYTES = 1_000_000_000
FORMATS = "PX4 .ulg, ArduPilot .bin, MAVLink .tlog, SBET (.out, .sbet), .gpx, .csv or .trj"
TEXT_SUFFIXES = (".csv", ".txt", ".trj")
Reader = Callable[[Path, str], FlightLog]
# The reader of each format, and the package that it needs.
READERS: dict[str, tuple[Reader, str | None]] = {
    "ulog": (read_ulog, "pyulog"),
    "dataflash": (read_dataflash, None),
    "telemetry": (read_telemetry, "pymavlink"),
    "gpx": (read_gpx, "gpxpy"),
    "csv": (read_csv, None),
    "sbet": (read_sbet, None),
}


def read_log(
    path: Path, name: str = "log", columns: Mapping[str, str] = AS_THEY_ARE, crs: str | None = None
) -> FlightLog:
    """Return the flight in a log, its times counted from the first position.

    name: prefix of error messages: the key or option that names the file.
    columns: columns of a CSV file by our names, where they differ.
    crs: coordinate reference system of a CSV file's map coordinates, such as "EPSG:25832".

    Raises ScenarioError if there is no such CRS, or it does not contain the flight; InputFileError for no flight log, a
    damaged one, or a format whose package is not installed.
    """
    regular_file(path, name, f"give a log of a flight: {FORMATS}", MAX_BYTES)
    kind = _kind(path, name)
    reader, package = READERS[kind]
    if package is not None and find_spec(package) is None:
        raise InputFileError(f"{name} {shown(path)} needs {package}; install it: pip install 'sionna_radar[logs]'")
    for key, given in (("platform.log_columns", columns), ("platform.log_crs", crs)):
        if given and kind != "csv":
            raise InputFileError(f"{name} {shown(path)} is no CSV file, and {key} is of columns of one; remove it")
    known_crs = None if crs is None else map_coordinates(crs)
    log = read_csv(path, name, columns, known_crs) if kind == "csv" else reader(path, name)
    log = replace(log, positions=log.positions.rows(np.isfinite(log.positions.time_s)))
    if len(log.positions.time_s) < 2:
        raise InputFileError(f"{name} {shown(path)}: has {len(log.positions.time_s)} positions; a flight needs more")
    start = float(log.positions.time_s[0])
    attitudes, spreads = log.attitudes, log.spreads
    return replace(
        log,
        positions=replace(log.positions, time_s=log.positions.time_s - start),
        attitudes=None if attitudes is None else replace(attitudes, time_s=attitudes.time_s - start),
        spreads=None if spreads is None else replace(spreads, time_s=spreads.time_s - start),
    )


def _kind(path: Path, name: str) -> str:
    with readable(path, name), path.open("rb") as file:
        head = file.read(1024)
    if path.suffix.lower() in SBET_SUFFIXES:
        return "sbet"
    if head.startswith(b"ULog"):
        return "ulog"
    if head.startswith(MAGIC):
        return "dataflash"
    if len(head) > 8 and head[8] in (V1, V2):
        return "telemetry"
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if text.startswith(b"<") or b"<\0" in text[:6]:
        return "gpx"
    if path.suffix.lower() in TEXT_SUFFIXES or b"time_s" in text:
        return "csv"
    raise InputFileError(f"{name} {shown(path)} is none of the known logs; give {FORMATS}")
