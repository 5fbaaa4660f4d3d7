"""The point cloud of a survey as a LAZ file."""

from collections.abc import Callable
from datetime import date
from pathlib import Path

import laspy
import numpy as np
from jaxtyping import Float, Int, UInt16
from laspy.header import GpsTimeType
from laspy.vlrs.known import WktCoordinateSystemVlr
from pyproj import CRS
from pyproj.enums import WktVersion
from pyproj.exceptions import CRSError

from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.raster import Georeference
from sionna_radar.mapping.points import Points

POINT_SCALE_M = 0.001
SCAN_ANGLE_STEP_DEG = 0.006
POINTS_AT_ONCE = 100_000
ACROSS = "across_sigma_m"
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
    """Write points as LAZ (LAS 1.4, point format 6).

    Beside the coordinates a point has `gps_time` (s since the start of the flight; declared as GPS week time, so the
    undated flight of a scenario starts at the beginning of a week), `scan_angle` (steps of 0.006 deg:
    the beam from the vertical, viewed along the flight, positive to the right), `intensity` (steps of 0.01 dB above
    the weakest echo) and the extra dimensions `snr_db`, `range_m`, `range_sigma_m`, `pulse`, `echo`, of points at
    measured directions `across_sigma_m`, and, in the coordinates of the points, the measured position of the radar:
    `radar_x`, `radar_y`, `radar_z`.

    Parameters
    ----------
    path:
        Output file.
    points:
        Points in the local frame.
    time_s:
        Times of all pulses, by their index.
    measured:
        Function from pulse indices to measured poses.
    georeference:
        Georeference of the local frame; without one the file has local coordinates and no CRS.

    """
    origin = np.array(georeference.origin_m if georeference else (0.0, 0.0, 0.0))
    header = _las_header(georeference, np.floor(origin))
    if points.across_sigma_m is not None:
        header.add_extra_dim(laspy.ExtraBytesParams(name=ACROSS, type="float32", description="sigma across ray (m)"))
    las = laspy.LasData(header)
    las.xyz = points.position_m + origin
    las.gps_time = time_s[points.pulse]
    las.scan_angle = np.rint(_scan_angle_deg(points, measured) / SCAN_ANGLE_STEP_DEG).astype(np.int16)
    las.intensity = _intensity(points.power)
    _, inverse, echoes = np.unique(points.pulse, return_inverse=True, return_counts=True)
    # LAS numbers the returns of a pulse in four bits, from one.
    las.return_number = np.minimum(points.number + 1, 15).astype(np.uint8)
    las.number_of_returns = np.minimum(echoes[inverse], 15).astype(np.uint8)
    las["snr_db"] = points.snr_db.astype(np.float32)
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
            laspy.ExtraBytesParams(name="snr_db", type="float32", description="signal to noise (dB)"),
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
    steps: UInt16[np.ndarray, " point"] = np.minimum(np.round(100 * above_db), 65535).astype(np.uint16)
    return steps
