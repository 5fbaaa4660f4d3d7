"""The points of a survey as a plain table: CSV, or Parquet where pyarrow is installed.

Column names carry units; a few thousand rows at a time are in memory. Positions are in map coordinates (`easting_m`,
`northing_m`, `height_m`) if georeferenced, otherwise in local metres (`east_m`, `north_m`, `up_m`).

The point cloud of a survey as a LAZ file.
"""

from collections.abc import Callable, Iterator, Mapping
from datetime import date
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt16
from pyproj import CRS
from pyproj.enums import WktVersion
from pyproj.exceptions import CRSError

from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.deferred import REQUESTS, deferred
from sionna_radar.foundation.errors import OutputError
from sionna_radar.foundation.raster import Georeference
from sionna_radar.mapping.points import Points

with deferred(REQUESTS):
    import laspy
    from laspy.header import GpsTimeType
    from laspy.vlrs.known import WktCoordinateSystemVlr

ROWS_AT_ONCE = 20_000
ROWS_OF_A_GROUP = 100_000
ON_MAP = ("easting_m", "northing_m", "height_m")
LOCAL = ("east_m", "north_m", "up_m")
# Tenths of a millimetre, microseconds, thousandths of a decibel: finer than the accuracy of the values.
FORMATS = {"pulse": "%d", "echo": "%d", "time_s": "%.6f", "echo_snr_db": "%.3f", "power_w": "%.6e", "power": "%.6e"}
LENGTH_FORMAT = "%.4f"
MEANING = {
    "pulse": "index of the pulse in the survey",
    "echo": "number of the echo in its pulse, 0 is the nearest",
    "time_s": "middle of the chirp, since the start of the flight",
    "range_m": "slant range, corrected for Doppler",
    "range_sigma_m": "standard deviation of the range",
    "across_sigma_m": "standard deviation of the position across the ray, in its vertical plane",
    "ground_probability": "that the point is of the ground and not of plants on it",
    "echo_snr_db": "of the echo's strongest cell over the noise",
    "power_w": "received, in the echo's strongest cell",
}


def columns_of(
    points: Points, time_s: Float[np.ndarray, " pulse"], georeference: Georeference | None, rows: slice = slice(None)
) -> dict[str, np.ndarray]:
    """Return the columns of some points by their names, in the order of the files.

    time_s: times of all pulses, by their index. georeference: of the local frame; None keeps local coordinates.
    """
    origin = np.array(georeference.origin_m if georeference else (0.0, 0.0, 0.0))
    axes = ON_MAP if georeference else LOCAL
    pulse = points.pulse[rows]
    place, radar = points.position_m[rows] + origin, points.origin_m[rows] + origin
    return {
        "pulse": pulse,
        "echo": points.number[rows],
        "time_s": time_s[pulse],
        **dict(zip(axes, place.T, strict=True)),
        "range_m": points.range_m[rows],
        "range_sigma_m": points.range_sigma_m[rows],
        **({} if points.across_sigma_m is None else {"across_sigma_m": points.across_sigma_m[rows]}),
        **({} if points.ground_probability is None else {"ground_probability": points.ground_probability[rows]}),
        "echo_snr_db": points.echo_snr_db[rows],
        "power_w": points.power[rows],
        **dict(zip([f"radar_{axis}" for axis in axes], radar.T, strict=True)),
    }


def write_points_csv(
    path: Path, points: Points, time_s: Float[np.ndarray, " pulse"], georeference: Georeference | None
) -> None:
    """Write points as CSV: a header, and lengths to a tenth of a millimetre; see `columns_of` for the arguments."""
    write_csv(path, len(points), lambda rows: columns_of(points, time_s, georeference, rows))


def write_csv(
    path: Path,
    count: int,
    columns: Callable[[slice], dict[str, np.ndarray]],
    formats: Mapping[str, str] = FORMATS,
    other_format: str = LENGTH_FORMAT,
) -> None:
    """Write columns of numbers as CSV, in blocks of rows; what is not known, NaN, is left empty."""
    names = list(columns(slice(0, 0)))
    line = ",".join(formats.get(name, other_format) for name in names) + "\n"
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for rows in _parts(count, ROWS_AT_ONCE):
            text = "".join([line % row for row in zip(*(c.tolist() for c in columns(rows).values()), strict=True)])
            file.write(text.replace("nan", ""))


def write_points_parquet(
    path: Path, points: Points, time_s: Float[np.ndarray, " pulse"], georeference: Georeference | None
) -> None:
    """Write points as Parquet, losslessly, with CRS and meanings as metadata; raises OutputError without pyarrow."""
    check_parquet()
    import pyarrow as pa
    from pyarrow.parquet import ParquetWriter

    empty = columns_of(points, time_s, georeference, slice(0, 0))
    fields = [_field(pa, name, column) for name, column in empty.items()]
    schema = pa.schema(fields, metadata={"crs": georeference.crs_wkt if georeference else "local"})
    with ParquetWriter(path, schema, compression="zstd") as file:
        for rows in _parts(len(points), ROWS_OF_A_GROUP):
            columns = columns_of(points, time_s, georeference, rows)
            file.write_table(pa.table(list(columns.values()), schema=schema))


def check_parquet(name: str = "points.parquet") -> None:
    """Raise OutputError, before the flight, if Parquet cannot be written."""
    if find_spec("pyarrow") is None:
        message = f"{name} needs pyarrow; install sionna-radar[parquet], or write CSV with --{Path(name).stem} csv"
        raise OutputError(message)


def _field(pa: Any, name: str, column: np.ndarray) -> Any:
    meaning = MEANING.get(name, "position, on the map if there is one")
    return pa.field(name, pa.from_numpy_dtype(column.dtype), metadata={"description": meaning})


def _parts(count: int, size: int) -> Iterator[slice]:
    return (slice(start, min(start + size, count)) for start in range(0, count, size))


POINT_SCALE_M = 0.001
SCAN_ANGLE_STEP_DEG = 0.006
POINTS_AT_ONCE = 100_000
ACROSS, GROUND = "across_sigma_m", "ground_probability"
LAS_GROUND, LAS_PLANTS = 2, 4
RADAR_PLACE = {
    "radar_x": "easting of the radar (m)",
    "radar_y": "northing of the radar (m)",
    "radar_z": "height of the radar (m)",
}


def write_laz(
    path: Path,
    points: Points,
    time_s: Float[np.ndarray, " pulse"],
    measured: Callable[[Int[np.ndarray, " pulse"]], Pose],
    georeference: Georeference | None,
) -> None:
    """Write points as LAZ (LAS 1.4, point format 6); without a georeference in local coordinates, and without a CRS.

    Beside the coordinates a point has `gps_time` (s since the start of the flight; declared as GPS week time, so the
    undated flight of a scenario starts at the beginning of a week), `scan_angle` (steps of 0.006 deg:
    the beam from the vertical, viewed along the flight, positive to the right), `intensity` (steps of 0.01 dB above
    the weakest echo) and the extra dimensions `echo_snr_db`, `range_m`, `range_sigma_m`, `pulse`, `echo`, of points at
    measured directions `across_sigma_m`, and, in the coordinates of the points, the measured position of the radar:
    `radar_x`, `radar_y`, `radar_z`. Where a map tells the ground from plants, `classification` is 2 for points of the
    ground, 4 for those of plants (medium vegetation of LAS), and `ground_probability` how sure that is.

    time_s, measured: times of all pulses, and their measured poses, by their indices.
    """
    origin = np.array(georeference.origin_m if georeference else (0.0, 0.0, 0.0))
    header = _las_header(georeference, np.floor(origin))
    if points.across_sigma_m is not None:
        header.add_extra_dim(laspy.ExtraBytesParams(name=ACROSS, type="float32", description="sigma across ray (m)"))
    if points.ground_probability is not None:
        header.add_extra_dim(laspy.ExtraBytesParams(name=GROUND, type="float32", description="probability of ground"))
    las = laspy.LasData(header)
    if points.ground_probability is not None:
        las.classification = np.where(points.ground_probability >= 0.5, LAS_GROUND, LAS_PLANTS).astype(np.uint8)
        las[GROUND] = points.ground_probability.astype(np.float32)
    # Not `las.xyz`, which refuses arrays that were unpickled.
    las.x, las.y, las.z = (points.position_m + origin).T
    las.gps_time = time_s[points.pulse]
    las.scan_angle = np.rint(_scan_angle_deg(points, measured) / SCAN_ANGLE_STEP_DEG).astype(np.int16)
    las.intensity = _intensity(points.power)
    _, inverse, echoes = np.unique(points.pulse, return_inverse=True, return_counts=True)
    # LAS numbers the returns of a pulse in four bits, from one.
    las.return_number = np.minimum(points.number + 1, 15).astype(np.uint8)
    las.number_of_returns = np.minimum(echoes[inverse], 15).astype(np.uint8)
    las["echo_snr_db"] = points.echo_snr_db.astype(np.float32)
    las["range_m"] = points.range_m
    las["range_sigma_m"] = points.range_sigma_m.astype(np.float32)
    if points.across_sigma_m is not None:
        las[ACROSS] = points.across_sigma_m.astype(np.float32)
    for name, column in zip(RADAR_PLACE, (points.origin_m + origin).T, strict=True):
        las[name] = column
    las["pulse"] = points.pulse.astype(np.uint32)
    las["echo"] = np.minimum(points.number, 255).astype(np.uint8)
    las.write(path)


def _scan_angle_deg(
    points: Points, measured: Callable[[Int[np.ndarray, " pulse"]], Pose]
) -> Float[np.ndarray, " point"]:
    """Return the angle of the beam from the vertical about the direction of flight, positive to the right."""
    angle = np.zeros(len(points))
    for start in range(0, len(points), POINTS_AT_ONCE):
        rows = slice(start, start + POINTS_AT_ONCE)
        pulse, row = np.unique(points.pulse[rows], return_inverse=True)
        forward = measured(pulse).velocity_mps[row, :2]
        east, north, up = (points.position_m[rows] - points.origin_m[rows]).T
        to_the_right = (forward[:, 1] * east - forward[:, 0] * north) / np.linalg.norm(forward, axis=1)
        angle[rows] = np.rad2deg(np.arctan2(to_the_right, -up))
    return angle


def _las_header(georeference: Georeference | None, offset_m: Float[np.ndarray, " 3"]) -> laspy.LasHeader:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, POINT_SCALE_M)
    header.offsets = offset_m
    header.generating_software = "sionna-radar"
    header.system_identifier = "simulated FMCW radar"
    # A fixed date, so that files of the same survey are identical.
    header.creation_date = date(2000, 1, 1)
    # The standard requires this bit with point format 6, with or without a CRS.
    header.global_encoding.wkt = True
    header.global_encoding.gps_time_type = GpsTimeType.WEEK_TIME
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(name="echo_snr_db", type="float32", description="signal to noise (dB)"),
            laspy.ExtraBytesParams(name="range_m", type="float64", description="slant range (m)"),
            laspy.ExtraBytesParams(name="range_sigma_m", type="float32", description="standard dev. of range (m)"),
            *(laspy.ExtraBytesParams(name=name, type="float64", description=d) for name, d in RADAR_PLACE.items()),
            laspy.ExtraBytesParams(name="pulse", type="uint32", description="index of pulse in survey"),
            laspy.ExtraBytesParams(name="echo", type="uint8", description="0 is nearest of its pulse"),
        ]
    )
    if georeference:
        header.vlrs.append(WktCoordinateSystemVlr(_las_wkt(CRS.from_wkt(georeference.crs_wkt))))
    return header


def _las_wkt(crs: CRS) -> str:
    """Return WKT 1, as specified by LAS 1.4, or the CRS's own form if WKT 1 cannot express it."""
    try:
        return crs.to_wkt(WktVersion.WKT1_GDAL) or crs.to_wkt()
    except CRSError:
        return crs.to_wkt()


def _intensity(power: Float[np.ndarray, " point"]) -> UInt16[np.ndarray, " point"]:
    if not np.any(power > 0):
        return np.zeros(len(power), dtype=np.uint16)
    weakest = power[power > 0].min()
    above_db = 10 * np.log10(np.maximum(power, weakest) / weakest)
    return np.minimum(np.round(100 * above_db), 65535).astype(np.uint16)
