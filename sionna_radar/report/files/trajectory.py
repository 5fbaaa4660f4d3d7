"""The flight of a survey as CSV, readable as `platform.log`, and as GPX if georeferenced."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Float
from pyproj import CRS

from sionna_radar.elevation.local_frame import frame_of
from sionna_radar.elevation.placed_raster import reproject
from sionna_radar.flight.flown_track import NO_PULSE, FlownTrack
from sionna_radar.foundation.raster import Georeference
from sionna_radar.report.files.points_table import write_csv

# Times losslessly, pulses as whole numbers, lengths to a micrometre.
FORMATS = {"time_s": "%r", "pulse": "%.0f", "longitude_deg": "%.10f", "latitude_deg": "%.10f"}
# A scenario has no date: its flights start at the beginning of a GPS week, a Sunday, as in points.laz.
START = datetime(2000, 1, 2, tzinfo=UTC)
AXES = ("east", "north", "up")
ANGLES = ("roll_deg", "pitch_deg", "heading_deg")
GPX_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<gpx version="1.1" creator="sionna-radar" xmlns="http://www.topografix.com/GPX/1/1">
<metadata><name>{name}</name><desc>{description}</desc></metadata>
<trk><name>{name}</name><trkseg>
"""


def write_trajectory_csv(path: Path, track: FlownTrack, georeference: Georeference | None) -> None:
    """Write a flight as CSV; NaN becomes an empty cell.

    The first columns are those of a log (`sionna_radar.readers.logs.csv_log`): time, true position in local metres,
    velocity and attitude at the navigation system, headings from grid north. Others follow: the pulse, the position on
    the map and in WGS 84 if georeferenced, and the antenna's true and measured pose.
    """
    columns = _columns(track, georeference)
    write_csv(path, len(track), lambda rows: {name: v[rows] for name, v in columns.items()}, FORMATS, "%.6f")


def write_gpx(path: Path, track: FlownTrack, georeference: Georeference, description: str = "") -> None:
    """Write the true positions of a flight as a GPX track in WGS 84, with a description.

    Elevations are heights in the vertical datum of the georeference, named in the description of the file. Times count
    from 2000-01-02T00:00:00Z, a Sunday, as a scenario has no date.
    """
    datum = georeference.vertical_name or "heights of the terrain, whose vertical datum is unknown"
    place = _lonlat(track.position_m, georeference)
    height_m = track.position_m[:, 2] + georeference.origin_m[2]
    name = escape("".join(c if c.isprintable() else " " for c in description).strip()) or "flight"
    about = f"Simulated flight. Elevations: {datum}. Times count from a made-up date, {START:%Y-%m-%d}."
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(GPX_HEAD.format(name=name, description=escape(about)))
        for (lon, lat), height, time_s in zip(place, height_m, track.time_s, strict=True):
            at = (START + timedelta(seconds=float(time_s))).isoformat(timespec="microseconds").replace("+00:00", "Z")
            point = f'<trkpt lat="{lat:.10f}" lon="{lon:.10f}"><ele>{height:.4f}</ele><time>{at}</time></trkpt>\n'
            file.write(point)
        file.write("</trkseg></trk>\n</gpx>\n")


def _columns(track: FlownTrack, place: Georeference | None) -> dict[str, np.ndarray]:
    columns: dict[str, np.ndarray] = {"time_s": track.time_s}
    columns |= _named([f"{axis}_m" for axis in AXES], track.position_m)
    columns |= _named([f"velocity_{axis}_mps" for axis in AXES], track.velocity_mps)
    columns |= _named(ANGLES, _degrees(track.euler_rad))
    columns["pulse"] = np.where(track.pulse == NO_PULSE, np.nan, track.pulse)
    if place is not None:
        columns |= _named(("easting_m", "northing_m", "elevation_m"), track.position_m + np.array(place.origin_m))
        columns |= _named(("longitude_deg", "latitude_deg"), _lonlat(track.position_m, place))
    columns |= _named([f"antenna_{axis}_m" for axis in AXES], track.antenna_m)
    columns |= _named([f"measured_antenna_{axis}_m" for axis in AXES], track.measured_antenna_m)
    columns |= _named([f"measured_velocity_{axis}_mps" for axis in AXES], track.measured_velocity_mps)
    return columns | _named([f"measured_{angle}" for angle in ANGLES], _degrees(track.measured_euler_rad))


def _named(names: "list[str] | tuple[str, ...]", columns: Float[np.ndarray, "row k"]) -> dict[str, np.ndarray]:
    return dict(zip(names, columns.T, strict=True))


def _degrees(euler_rad: Float[np.ndarray, "row 3"]) -> Float[np.ndarray, "row 3"]:
    degrees = np.rad2deg(euler_rad)
    degrees[:, 2] %= 360.0
    return degrees


def _lonlat(position_m: Float[np.ndarray, "row 3"], place: Georeference) -> Float[np.ndarray, "row 2"]:
    frame = frame_of(place)
    assert frame is not None
    east, north = (position_m[:, :2] + np.array(place.origin_m[:2])).T
    return np.column_stack(reproject(frame.crs, CRS(4326), east, north))
