"""The folder of a survey's results: numbers, scenario, point cloud, rasters and figures."""

from functools import partial
from pathlib import Path

from sionna_radar.report.coordinates import Coordinates
from sionna_radar.report.folder import write_folder, write_text
from sionna_radar.report.rasters import write_geotiff
from sionna_radar.report.survey.figures import draw_all
from sionna_radar.report.survey.point_cloud import write_laz
from sionna_radar.report.survey.summary import summary_json, versions
from sionna_radar.scenario import to_toml
from sionna_radar.survey.result import Survey

MARKER = "summary.json"


def write_survey(survey: Survey, directory: Path, coordinates: Coordinates = Coordinates.MAP) -> list[Path]:
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
    return write_folder(directory, MARKER, partial(_write_all, survey, coordinates))


def _write_all(survey: Survey, coordinates: Coordinates, directory: Path) -> None:
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
