"""A finished survey, read back from its folder of results, and its figures drawn there.

World and flight follow from the scenario in the folder; points, DEM and lit cells are read, rounded as the files hold
them. Nothing is flown but the one chirp that the figures show.
"""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.raster import Georeference, Grid, Raster
from sionna_radar.mapping.points import Points
from sionna_radar.report.coordinates import Coordinates
from sionna_radar.report.files.contents import FIGURES, MARKER, write_text
from sionna_radar.report.files.folder import check_output, write_folder
from sionna_radar.report.files.manifest import MANIFEST, read_manifest
from sionna_radar.report.files.points_table import LOCAL, ON_MAP
from sionna_radar.scenario import load_scenario
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.result import Survey

POINTS = "points.csv"


@on_one_thread
def read_survey(directory: str | Path) -> Survey:
    """Return the survey of a folder that `write_survey` wrote.

    Points have the precision of `points.csv`, heights that of the GeoTIFFs; stated uncertainties are not read.

    Parameters
    ----------
    directory:
        The folder of results.

    Returns
    -------
    The survey, for its figures and errors.

    Raises
    ------
    InputFileError
        It is no such folder, lacks a file, or holds a survey with custom parts, which no file describes.
    ScenarioError
        Files that its scenario names are gone; see `prepare`.

    Examples
    --------
    >>> from pathlib import Path
    >>> survey = run(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> files = write_survey(survey, Path("results"))
    >>> again = read_survey("results")
    >>> len(again.points) == len(survey.points)
    True
    """
    directory = Path(directory).expanduser()
    manifest = read_manifest(directory / MANIFEST)
    if manifest is None or manifest.kind != MARKER:
        raise InputFileError(f"{shown(directory)} holds no survey; name a folder that `run` or `demo` wrote")
    needed = (MARKER, "scenario.toml", POINTS, "dem.tif", "lit.tif")
    missing = [name for name in needed if not (directory / name).is_file()]
    if missing:
        raise InputFileError(f"{shown(directory)} lacks {', '.join(missing)}; run the survey again with `--figures`")
    summary = json.loads((directory / MARKER).read_text(encoding="utf-8"))
    if summary["replaced"]:
        names = ", ".join(summary["replaced"])
        raise InputFileError(f"{shown(directory)} was flown with {names} replaced from Python; draw it there")
    prepared = prepare(load_scenario(directory / "scenario.toml"))
    grid, place = prepared.truth.grid, prepared.world.scene.georeference
    points = _read_points(directory / POINTS, place)
    dem = Raster(grid=grid, height_m=_heights(directory / "dem.tif", grid) - (place.origin_m[2] if place else 0.0))
    lit = _heights(directory / "lit.tif", grid) == 1
    sensor = prepared.build_sensor()
    return Survey(
        **vars(prepared.truth.compare(dem, points, lit)),
        prepared=prepared,
        paths=int(summary["paths"]),
        points=points,
        dem=dem,
        chirp=sensor.record_chirp(prepared.flight.pulses(np.array([len(prepared) // 2]))),
        warnings=tuple(summary["warnings"]),
        sensor=sensor,
    )


def _heights(path: Path, grid: Grid) -> np.ndarray:
    """Return the values of a raster in the cells of a grid, from south to north."""
    values = Raster.read(path).height_m
    if values.shape != grid.shape:
        raise InputFileError(f"{shown(path)} has {values.shape} cells, not the {grid.shape} of its scenario")
    return values


def _read_points(path: Path, place: Georeference | None) -> Points:
    """Return the points of a table in local coordinates."""
    with path.open(encoding="utf-8", newline="") as file:
        names = next(csv.reader(file))
        table = np.loadtxt(file, delimiter=",", ndmin=2).reshape(-1, len(names))
    column = dict(zip(names, table.T, strict=True))
    origin, axes = np.array(place.origin_m if place else (0.0, 0.0, 0.0)), ON_MAP if place else LOCAL
    return Points(
        pulse=column["pulse"].astype(np.int64),
        number=column["echo"].astype(np.int64),
        position_m=np.column_stack([column[axis] for axis in axes]) - origin,
        origin_m=np.column_stack([column[f"radar_{axis}"] for axis in axes]) - origin,
        range_m=column["range_m"],
        range_sigma_m=column["range_sigma_m"],
        power=column["power_w"],
        echo_snr_db=column["echo_snr_db"],
        across_sigma_m=column.get("across_sigma_m"),
    )


def draw_figures(directory: str | Path, coordinates: Coordinates = Coordinates.MAP) -> list[Path]:
    """Draw the figures of a finished survey into its folder, as `--figures` does, and return the files.

    directory: the folder of results; its other files stay as they are.
    coordinates: of the figures.

    Raises InputFileError and ScenarioError as `read_survey`, OutputError as `write_folder`.
    """
    from sionna_radar.report.survey.figures import draw_all

    directory = Path(directory).expanduser()
    survey = read_survey(directory)
    earlier = read_manifest(check_output(directory, MARKER) / MANIFEST)
    assert earlier is not None  # `read_survey` has read it

    def fill(folder: Path) -> None:
        for name in earlier.files:
            if (directory / name).exists() and not name.startswith(f"{FIGURES}/"):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(directory / name, folder / name)
        draw_all(survey, folder / FIGURES, coordinates)

    written = write_folder(directory, MARKER, fill)
    manifest = read_manifest(directory / MANIFEST)
    assert manifest is not None
    write_text(directory / MANIFEST, replace(manifest, run=earlier.run, exit_code=earlier.exit_code).text())
    return [path for path in written if path.parent.name == FIGURES]
