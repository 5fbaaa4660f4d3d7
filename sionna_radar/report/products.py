"""The folder of a survey's results: numbers, scenario, point cloud, rasters and figures."""

import warnings
from datetime import date
from functools import partial
from pathlib import Path

import laspy
import numpy as np
import rasterio
from jaxtyping import Float, UInt16
from laspy.vlrs.known import WktCoordinateSystemVlr
from pyproj import CRS
from pyproj.enums import WktVersion
from pyproj.exceptions import CRSError
from rasterio.errors import NotGeoreferencedWarning
from rasterio.transform import Affine

from sionna_radar.georeference import Georeference
from sionna_radar.mapping.points import Points
from sionna_radar.raster import Grid, Raster
from sionna_radar.report.coordinates import Coordinates
from sionna_radar.report.figures import draw_all
from sionna_radar.report.folder import write_folder, write_text
from sionna_radar.report.summary import summary_json
from sionna_radar.scenario import to_toml
from sionna_radar.survey import Survey

MARKER = "summary.json"
POINT_SCALE_M = 0.001


def write_products(survey: Survey, directory: Path, coordinates: Coordinates = Coordinates.MAP) -> list[Path]:
    """Write the results into a directory, whole or not at all, and return the files.

    Of what the directory holds, the files of an earlier result are replaced, if nobody has changed them since.

    Parameters
    ----------
    survey:
        A finished survey.
    directory:
        Where to write.
    coordinates:
        Those of the figures; rasters and points always have map coordinates where there are any.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written; see `write_folder`.

    """
    return write_folder(directory, MARKER, partial(_write_all, survey, coordinates))


def _write_all(survey: Survey, coordinates: Coordinates, directory: Path) -> None:
    place = survey.georeference
    write_text(directory / MARKER, summary_json(survey))
    write_text(directory / "scenario.toml", _header(survey) + to_toml(survey.scenario))
    write_laz(directory / "points.laz", survey.points, survey.schedule.time_s, place)
    origin_height_m = place.origin_m[2] if place else 0.0
    write_geotiff(directory / "dem.tif", survey.dem, place, "DEM height", origin_height_m)
    write_geotiff(directory / "truth.tif", survey.truth, place, "true height", origin_height_m)
    # A difference of heights does not depend on where they are counted from.
    write_geotiff(directory / "error.tif", survey.error, place, "DEM minus truth", 0.0)
    draw_all(survey, directory / "figures", coordinates)


def _header(survey: Survey) -> str:
    """Return the comment that says what in the scenario is not what was flown."""
    if not survey.replaced:
        return ""
    replaced = "".join(f"#   {key}: {what}\n" for key, what in survey.replaced.items())
    return f"# This file alone does not repeat the survey. Replaced from Python:\n{replaced}\n"


def write_geotiff(
    path: Path, raster: Raster, georeference: Georeference | None, description: str, height_offset_m: float
) -> None:
    """Write a raster as a float32 GeoTIFF, rows from north to south and empty cells NaN.

    Parameters
    ----------
    path:
        Where to write.
    raster:
        Heights in the local frame.
    georeference:
        Place of the local frame; without one the file has local coordinates and no CRS.
    description:
        What the band holds.
    height_offset_m:
        Added to the heights.

    """
    grid = raster.grid
    profile = {
        "driver": "GTiff",
        "dtype": "float32",
        "count": 1,
        "height": grid.rows,
        "width": grid.columns,
        "nodata": np.nan,
        "crs": georeference.crs_wkt if georeference else None,
        "transform": _transform(grid, georeference),
        "compress": "deflate",
        "predictor": 3,
    }
    with warnings.catch_warnings():
        # A local raster of unit cells in the corner of the frame is what rasterio takes for no place at all.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        file = rasterio.open(path, "w", **profile)
    with file:
        file.write((raster.height_m[::-1] + height_offset_m).astype(np.float32), 1)
        file.set_band_description(1, description)
        file.units = ("m",)


def _transform(grid: Grid, georeference: Georeference | None) -> Affine:
    """Return the map from columns and rows, counted from the north-west corner, to coordinates."""
    east_m, north_m = georeference.origin_m[:2] if georeference else (0.0, 0.0)
    west_edge, _, _, north_edge = grid.extent_m
    size = grid.spacing_m
    # To a micrometre: sums of local and map coordinates leave round-off that other rasters of the same cells have not.
    # Not rasterio's from_origin: it multiplies in a way that affine 3 warns of.
    return Affine(size, 0.0, round(west_edge + east_m, 6), 0.0, -size, round(north_edge + north_m, 6))


def write_laz(
    path: Path,
    points: Points,
    pulse_time_s: Float[np.ndarray, " pulse"],
    georeference: Georeference | None,
) -> None:
    """Write points as LAZ (LAS 1.4, point format 6).

    Beside the coordinates a point has `gps_time` (s since the start of the flight), `intensity` (steps of
    0.01 dB above the weakest echo) and the extra dimensions `snr_db`, `range_m`, `pulse` and `echo`.

    Parameters
    ----------
    path:
        Where to write.
    points:
        Points in the local frame.
    pulse_time_s:
        Times of all pulses of the survey.
    georeference:
        Place of the local frame; without one the file has local coordinates and no CRS.

    """
    origin = np.array(georeference.origin_m if georeference else (0.0, 0.0, 0.0))
    las = laspy.LasData(_las_header(georeference, np.floor(origin)))
    las.xyz = points.position_m + origin
    las.gps_time = pulse_time_s[points.pulse]
    las.intensity = _intensity(points.power)
    _, inverse, echoes = np.unique(points.pulse, return_inverse=True, return_counts=True)
    # LAS counts the returns of a pulse in four bits, from one.
    las.return_number = np.minimum(points.number + 1, 15).astype(np.uint8)
    las.number_of_returns = np.minimum(echoes[inverse], 15).astype(np.uint8)
    las["snr_db"] = points.snr_db.astype(np.float32)
    las["range_m"] = points.range_m
    las["pulse"] = points.pulse.astype(np.uint32)
    las["echo"] = np.minimum(points.number, 255).astype(np.uint8)
    las.write(path)


def _las_header(georeference: Georeference | None, offset_m: Float[np.ndarray, " 3"]) -> laspy.LasHeader:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, POINT_SCALE_M)
    header.offsets = offset_m
    header.generating_software = "sionna-radar"
    header.system_identifier = "simulated FMCW radar"
    # A day without a time zone: files of the same survey are the same, wherever and whenever they are written.
    header.creation_date = date(2000, 1, 1)
    # The standard asks for this bit with point format 6, whether or not a CRS follows.
    header.global_encoding.wkt = True
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(name="snr_db", type="float32", description="signal to noise (dB)"),
            laspy.ExtraBytesParams(name="range_m", type="float64", description="slant range (m)"),
            laspy.ExtraBytesParams(name="pulse", type="uint32", description="running number of pulse"),
            laspy.ExtraBytesParams(name="echo", type="uint8", description="0 is nearest of its pulse"),
        ]
    )
    if georeference:
        header.vlrs.append(WktCoordinateSystemVlr(_las_wkt(CRS.from_wkt(georeference.crs_wkt))))
    return header


def _las_wkt(crs: CRS) -> str:
    """Return WKT 1, which LAS 1.4 names, or the CRS's own form where WKT 1 has no words for it."""
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
