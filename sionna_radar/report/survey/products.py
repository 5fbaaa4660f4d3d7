"""The folder of a survey's results: numbers, scenario, point cloud, rasters and figures."""

import logging
import warnings
from collections.abc import Mapping
from enum import Enum
from functools import partial
from pathlib import Path

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from rasterio.transform import Affine

from sionna_radar.foundation.errors import OutputError
from sionna_radar.foundation.georeference import Georeference
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.report.coordinates import Coordinates
from sionna_radar.report.folder import write_folder, write_text
from sionna_radar.report.survey.figures import draw_all
from sionna_radar.report.survey.page import survey_page
from sionna_radar.report.survey.point_cloud import write_laz
from sionna_radar.report.survey.summary import summary_json, versions
from sionna_radar.scenario import to_toml
from sionna_radar.survey.result import Survey

MARKER = "summary.json"
logger = logging.getLogger("sionna_radar")


class Report(Enum):
    """Whether a folder of results has a page to look at, `report.html`."""

    PAGE = "page"
    NONE = "none"


def write_survey(
    survey: Survey,
    directory: Path,
    coordinates: Coordinates = Coordinates.MAP,
    report: Report = Report.PAGE,
) -> list[Path]:
    """Write the results into a directory, completely or not at all, and return the files.

    Files of an earlier result in the directory are replaced if they were not changed since.

    Parameters
    ----------
    survey:
        A finished survey.
    directory:
        Where to write.
    coordinates:
        Those of the figures; rasters and points always have map coordinates if the scene is georeferenced.
    report:
        Whether to write the page, `report.html`.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written; see `write_folder`.

    Examples
    --------
    >>> from pathlib import Path
    >>> survey = run(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> files = write_survey(survey, Path("results"))
    >>> [file.name for file in files if file.suffix == ".tif"]
    ['dem.tif', 'error.tif', 'truth.tif']

    """
    return write_folder(directory, MARKER, partial(_write_all, survey, coordinates, report))


def _write_all(survey: Survey, coordinates: Coordinates, report: Report, directory: Path) -> None:
    place = survey.georeference
    write_text(directory / MARKER, summary_json(survey))
    write_text(directory / "scenario.toml", _header(survey) + to_toml(survey.scenario))
    write_laz(directory / "points.laz", survey.points, survey.schedule, place)
    origin_height_m = place.origin_m[2] if place else 0.0
    rasters = {
        "dem": (survey.dem, "DEM height", origin_height_m),
        "truth": (survey.truth, "true height", origin_height_m),
        # A difference of heights does not depend on their datum.
        "error": (survey.error, "DEM minus truth", 0.0),
    }
    made_by = provenance(survey)
    for name, (raster, description, offset_m) in rasters.items():
        write_geotiff(directory / f"{name}.tif", raster, place, description, offset_m, made_by)
    draw_all(survey, directory / "figures", coordinates)
    if report is Report.PAGE:
        _write_page(survey, coordinates, directory / "report.html")


def _write_page(survey: Survey, coordinates: Coordinates, path: Path) -> None:
    """Write the page; one that cannot be made does not keep the results from being written."""
    try:
        write_text(path, survey_page(survey, coordinates))
    except OutputError as error:
        logger.warning("no report.html: %s", error)


def _header(survey: Survey) -> str:
    """Return the comment that lists the parts of the scenario replaced in the survey."""
    if not survey.replaced:
        return ""
    replaced = "".join(f"#   {key}: {what}\n" for key, what in survey.replaced.items())
    return f"# This file alone does not repeat the survey. Replaced from Python:\n{replaced}\n"


def provenance(survey: Survey) -> dict[str, str]:
    """Return the origin of a raster as TIFF and GDAL metadata; undated, so that equal surveys give equal files."""
    description = "".join(c if c.isprintable() else " " for c in survey.scenario.description)
    return {
        "TIFFTAG_SOFTWARE": f"sionna-radar {versions()['sionna-radar']}",
        **({"TIFFTAG_IMAGEDESCRIPTION": description} if description else {}),
        "SEED": str(survey.scenario.seed),
        "POINTS_SHA256": survey.points.sha256(),
    }


def write_geotiff(
    path: Path,
    raster: Raster,
    georeference: Georeference | None,
    description: str,
    height_offset_m: float,
    metadata: Mapping[str, str] | None = None,
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
        Offset added to the heights.
    metadata:
        Metadata of the file, besides the band's description.

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
        # rasterio takes a local raster of unit cells in the corner of the frame for one without a transform.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        file = rasterio.open(path, "w", **profile)
    with file:
        file.write((raster.height_m[::-1] + height_offset_m).astype(np.float32), 1)
        file.set_band_description(1, description)
        file.units = ("m",)
        file.update_tags(**(metadata or {}), QUANTITY=description, UNITS="m")


def _transform(grid: Grid, georeference: Georeference | None) -> Affine:
    """Return the transform from columns and rows, numbered from the north-west corner, to coordinates."""
    east_m, north_m = georeference.origin_m[:2] if georeference else (0.0, 0.0)
    west_edge, _, _, north_edge = grid.extent_m
    size = grid.spacing_m
    # To a micrometre: sums of local and map coordinates have round-off that other rasters of the same cells lack.
    # Not rasterio's from_origin: its multiplication causes a warning with affine 3.
    return Affine(size, 0.0, round(west_edge + east_m, 6), 0.0, -size, round(north_edge + north_m, 6))
