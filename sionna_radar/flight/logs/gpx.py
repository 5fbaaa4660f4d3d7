"""Flights as GPX tracks: longitude, latitude, elevation and time, and nothing else.

The standard says "elevation in metres" and no more; receivers write heights above mean sea level, which is assumed.
"""

from pathlib import Path
from typing import Any

import numpy as np

from sionna_radar.flight.logs.log import FlightLog, Positions, source_of
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import regular_file, shown

MOST_BYTES = 50_000_000


def read_gpx(path: Path, name: str) -> FlightLog:
    """Return the flight in a GPX file: the points of all tracks, one after the other.

    Raises
    ------
    InputFileError
        It is not XML or has entities, holds no timed track, or points without an elevation.

    """
    where = f"{name} {shown(path)}"
    regular_file(path, name, "give a GPX track", MOST_BYTES)
    points = [point for track in _parsed(path, where).tracks for part in track.segments for point in part.points]
    if len(points) < 2:
        message = f"{where}: holds {len(points)} points of a track; give a recorded track, not a route or waypoints"
        raise InputFileError(message)
    for number, point in enumerate(points):
        if point.time is None:
            message = f"{where}: point {number + 1} of the track has no time; give a recorded track"
            raise InputFileError(message)
        if point.elevation is None:
            message = f"{where}: point {number + 1} of the track has no elevation; add <ele>, or drop the point"
            raise InputFileError(message)
    first = points[0].time
    try:
        time_s = np.array([(point.time - first).total_seconds() for point in points])
    except TypeError as error:
        message = f"{where}: some times have a zone and some have none; write all of them alike"
        raise InputFileError(message) from error
    place = np.array([[point.longitude, point.latitude, point.elevation] for point in points], dtype=float)
    positions = Positions(source="trkpt", time_s=time_s, place=place)
    return FlightLog(
        kind="GPX",
        on_map=True,
        datum="mean sea level",
        positions=positions,
        attitudes=None,
        spreads=None,
        sources=(source_of("trkpt", time_s),),
        notes=("elevations of GPX are taken as heights above mean sea level",),
    )


def _parsed(path: Path, where: str) -> Any:
    import gpxpy
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        content = path.read_bytes()
        # gpxpy expands entities with whatever parser is installed: none reach it.
        fromstring(content, forbid_dtd=True)
        return gpxpy.parse(content.decode("utf-8-sig") if _is_utf8(content) else content)
    except DefusedXmlException as error:
        message = f"{where}: declares entities or a document type, which GPX does not need; remove them"
        raise InputFileError(message) from error
    except InputFileError:
        raise
    except (Exception, RecursionError) as error:  # gpxpy and the XML parsers raise whatever they like
        message = f"{where} is not GPX ({str(error)[:100]}); give a GPX track"
        raise InputFileError(message) from error


def _is_utf8(content: bytes) -> bool:
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True
