"""The folder of a survey's results: numbers, scenario, points, rasters, flight and figures."""

import shutil
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool

from sionna_radar.accuracy.truth import Comparison
from sionna_radar.execution.workers import versions
from sionna_radar.flight.flown_track import flown_track
from sionna_radar.foundation.raster import Raster
from sionna_radar.inference.terrain.uncertainty import Uncertainty
from sionna_radar.mapping.linear.linear import LinearUncertainty
from sionna_radar.mapping.mapper import CanopyMap
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.stepped.uncertainty import SteppedUncertainty
from sionna_radar.report.coordinates import Coordinates
from sionna_radar.report.files.contents import COSTS, MARKER, POINTS_FILES, Figures, PointsFile, Report, costs_json
from sionna_radar.report.files.navigation import write_navigation
from sionna_radar.report.files.points_table import write_laz, write_points_csv, write_points_parquet
from sionna_radar.report.files.trajectory import write_gpx, write_trajectory_csv
from sionna_radar.report.study_document import StudyDocument
from sionna_radar.report.survey.obstacles import objects_csv, write_obstacles
from sionna_radar.report.survey.page import survey_page
from sionna_radar.report.survey.summary import summary, survey_table
from sionna_radar.scenario import Scenario, to_toml
from sionna_radar.survey.result import Processed, Survey

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# GPS receivers log about this often.
GPX_STEP_S = 0.2


def write_survey(
    survey: Survey,
    directory: str | Path,
    coordinates: Coordinates = Coordinates.MAP,
    *,
    report: Report = Report.PAGE,
    points: Collection[PointsFile] = POINTS_FILES,
    figures: Figures = Figures.NONE,
    recordings: Mapping[str, Path] | None = None,
) -> list[Path]:
    """Write the results into a directory, completely or not at all, and return the files.

    Files of an earlier result in the directory are replaced if unchanged. `examples/PRODUCTS.md` describes the contents
    of each file.

    Parameters
    ----------
    survey:
        A finished survey.
    directory:
        Output folder.
    coordinates:
        Coordinates of the figures; rasters and points always have map coordinates if the scene is georeferenced.
    report:
        Selects the page, `report.html`.
    points:
        Formats of the points.
    figures:
        Selects the figures, `figures/*.png`; `draw_figures` adds them later.
    recordings:
        Finished recordings by kind, which are moved to the results as KIND.nc.

    Returns
    -------
    The files written, sorted.

    Raises
    ------
    OutputError
        The directory holds other files, or cannot be written; see `write_folder`. Parquet needs pyarrow.

    Examples
    --------
    >>> from pathlib import Path
    >>> survey = run(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> files = write_survey(survey, Path("results"))
    >>> [file.name for file in files if file.suffix == ".tif"]
    ['dem.tif', 'dem_sigma.tif', 'error.tif', 'lit.tif', 'truth.tif']
    """
    return survey_document(coordinates, points, figures, recordings).write(survey, Path(directory), report=report)


def survey_document(
    coordinates: Coordinates = Coordinates.MAP,
    points: Collection[PointsFile] = POINTS_FILES,
    figures: Figures = Figures.NONE,
    recordings: Mapping[str, Path] | None = None,
) -> StudyDocument[Survey]:
    """Return the document of a survey; the arguments are those of `write_survey`."""
    return StudyDocument(
        marker=MARKER,
        suffix="",
        numbers=summary,
        tables=lambda survey: [survey_table(survey)],
        figures=partial(_figures_of, coordinates) if figures is Figures.PNG else lambda _: {},
        notebook=["dem"],
        texts={
            COSTS: lambda survey: costs_json(survey.timing_s, survey.peak_memory_mb),
            "scenario.toml": lambda survey: _header(survey) + to_toml(survey.scenario),
            "objects.csv": lambda survey: objects_csv(survey.obstacles),
        },
        files=[
            *(partial(_write_points, kind=kind) for kind in PointsFile if kind in points),
            _write_rasters,
            _write_trajectory,
            _write_obstacles,
            write_navigation,
            *(partial(_move, path, kind) for kind, path in (recordings or {}).items()),
        ],
        page=partial(survey_page, coordinates=coordinates),
    )


def _figures_of(coordinates: Coordinates, survey: Survey) -> "Mapping[str, Callable[[Survey], Figure]]":
    # matplotlib takes longer to load than a short survey to simulate.
    from sionna_radar.report.survey.figures import figures_of

    return figures_of(survey, coordinates)


def _move(recording: Path, kind: str, _: Survey, directory: Path) -> None:
    shutil.move(recording, directory / f"{kind}.nc")


def _write_obstacles(survey: Survey, directory: Path) -> None:
    if survey.obstacles is not None and survey.obstacles.reported is not None:
        write_obstacles(directory / "obstacles.gpkg", survey.obstacles.reported, survey.georeference)


def _write_points(survey: Survey, directory: Path, kind: PointsFile) -> None:
    path, place = directory / f"points.{kind}", survey.georeference
    points, time_s = survey.points, survey.schedule.time_s
    match kind:
        case PointsFile.LAZ:
            write_laz(path, points, time_s, survey.prepared.measured, place)
        case PointsFile.CSV:
            write_points_csv(path, points, time_s, place)
        case PointsFile.PARQUET:
            write_points_parquet(path, points, time_s, place)


def _write_rasters(survey: Survey, directory: Path) -> None:
    rasters = rasters_of(survey, survey)
    rasters["dem_sigma_navigation"] = (
        survey.dem_sigma_navigation,
        "standard deviation of the DEM height from navigation",
    )
    rasters["lit"] = (_mask(survey, survey.lit), "1 where the main beam reached the true surface")
    if survey.no_echo is not None and survey.no_echo.any():
        rasters["no_echo"] = (_mask(survey, survey.no_echo), "1 where the beam met the surface and nothing came back")
    write_rasters(directory, survey, rasters)


def _mask(survey: Survey, cells: Bool[np.ndarray, "row column"]) -> Raster:
    return Raster(grid=survey.dem.grid, height_m=np.where(cells, 1.0, np.nan), quantity="mask")


Rasters = dict[str, tuple[Raster | None, str]]


def rasters_of(result: Survey | Processed, compared: Comparison | None) -> Rasters:
    """Return the rasters of a result by name, with descriptions; gross errors too of a `stepped` DEM."""
    dem, uncertainty = result.dem, result.uncertainty
    rasters: Rasters = {
        "dem": (dem, "DEM height"),
        "dem_sigma": (result.dem_sigma, f"standard deviation of the DEM height: {sigma_terms(uncertainty)}"),
        "truth": (compared.truth if compared else None, "true height"),
        "error": (compared.error if compared else None, "DEM minus truth"),
        "reference_error": (result.reference.error if result.reference else None, "DEM minus reference"),
    }
    if result.canopy is not None:
        rasters |= _canopy_rasters(result.canopy)
    if dem is None or not isinstance(uncertainty, SteppedUncertainty):
        return rasters
    probability, sigma_m = (
        np.where(dem.filled, values, np.nan) for values in (uncertainty.other_side, uncertainty.step_sigma_m)
    )
    chance = Raster(grid=dem.grid, height_m=probability, quantity="probability")
    sigma = Raster(grid=dem.grid, height_m=sigma_m, quantity="standard deviation of the height")
    return rasters | {
        "dem_other_side": (chance, "probability that the cell is of the other side of a step"),
        "dem_sigma_step": (sigma, "standard deviation of the DEM height from the other side of steps"),
    }


def _canopy_rasters(canopy: CanopyMap) -> Rasters:
    return {
        "canopy_top": (canopy.top, "height of the plants' top, of bare ground that itself"),
        "canopy_top_sigma": (canopy.top_sigma, "standard deviation of the top"),
        "canopy_height": (canopy.height, "height of the plants over the ground, 0 without any"),
        "canopy_height_sigma": (canopy.height_sigma, "standard deviation of the height of the plants, where there are"),
        "cover": (canopy.cover, "what is seen: 1 ground alone, 2 plants alone, 3 both"),
        "cover_probability": (canopy.plants, "probability of plants"),
    }


def sigma_terms(uncertainty: Uncertainty | None) -> str:
    """Return the error terms that the stated standard deviation of a DEM includes, and those it omits."""
    holds = ["speckle and noise of the echoes", "footprint", "ground between the echoes"]
    leaves_out = ["navigation", "range zero and scale", "mounting", "vertical datum"]
    if isinstance(uncertainty, SteppedUncertainty):
        holds.append("other side of a step")
    elif isinstance(uncertainty, LinearUncertainty):
        leaves_out.append("bias of the beam on slopes")
    if uncertainty is None:
        return "as its method states it"
    return f"{', '.join(holds)}; without what is common to all cells: {', '.join(leaves_out)}"


def write_rasters(directory: Path, result: Survey | Processed, rasters: Rasters) -> None:
    """Write the rasters that there are of a result by name, each with its description."""
    made_by = {} if result.points is None else _provenance(result.scenario, result.points)
    for name, (raster, description) in rasters.items():
        if raster is not None:
            raster.to_geotiff(directory / f"{name}.tif", description, made_by)


def _write_trajectory(survey: Survey, directory: Path) -> None:
    place = survey.georeference
    write_trajectory_csv(directory / "trajectory.csv", flown_track(survey.schedule), place)
    if place is not None:
        track = flown_track(survey.schedule, GPX_STEP_S)
        write_gpx(directory / "trajectory.gpx", track, place, survey.scenario.description)


def _header(survey: Survey) -> str:
    if not survey.replaced:
        return ""
    replaced = "".join(f"#   {key}: {part}\n" for key, part in survey.replaced.items())
    return f"# This file alone does not repeat the survey. Replaced from Python:\n{replaced}\n"


def _provenance(scenario: Scenario | None, points: Points) -> dict[str, str]:
    """Return the origin of a raster as TIFF and GDAL metadata; undated, so that equal surveys give equal files."""
    description = "".join(c if c.isprintable() else " " for c in scenario.description) if scenario else ""
    return {
        "TIFFTAG_SOFTWARE": f"sionna-radar {versions()['sionna-radar']}",
        **({"TIFFTAG_IMAGEDESCRIPTION": description} if description else {}),
        **({"SEED": str(scenario.seed)} if scenario else {}),
        "POINTS_SHA256": points.sha256(),
    }


DOCUMENT = survey_document(figures=Figures.PNG)
