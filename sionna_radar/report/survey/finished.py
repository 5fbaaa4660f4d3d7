"""A finished survey, read back from its folder of results, and its figures drawn there.

World and flight follow from the scenario in the folder; points, DEM, its standard deviation and lit cells are read,
rounded as the files hold them. Nothing is flown but the one chirp that the figures show.
"""

import json
import os
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import InputFileError, OutputError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.raster import Georeference, Grid, Raster
from sionna_radar.mapping.points import Points
from sionna_radar.report.coordinates import Coordinates
from sionna_radar.report.files.contents import FIGURES, MARKER
from sionna_radar.report.files.folder import check_output, write_folder
from sionna_radar.report.files.manifest import MANIFEST, keep_run, read_manifest
from sionna_radar.report.files.points_table import LOCAL, ON_MAP
from sionna_radar.scenario import load_scenario
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.result import Survey

POINTS = "points.csv"
NEEDED = (MARKER, "scenario.toml", POINTS, "dem.tif", "truth.tif", "lit.tif")
# Rasters that not every survey has.
SIGMA, SIGMA_NAVIGATION, NO_ECHO = "dem_sigma.tif", "dem_sigma_navigation.tif", "no_echo.tif"
READ = (*NEEDED, SIGMA, SIGMA_NAVIGATION, NO_ECHO)
# Heights and places that differ by less are the same: rasters hold them in single precision.
SAME_M = 0.01


@on_one_thread
def read_survey(directory: str | Path) -> Survey:
    """Return the survey of a folder that `write_survey` wrote.

    Points have the precision of `points.csv`, heights and standard deviations that of the GeoTIFFs. The covariance
    between cells is in no file: `uncertainty` is None, and nothing is stated of means over windows.

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
        It is no such folder, a file of it is missing, damaged or changed, its ground has changed, or it holds a survey
        with custom parts, which no file describes.
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
    missing = [name for name in NEEDED if not (directory / name).is_file()]
    if missing:
        raise InputFileError(f"{shown(directory)} lacks {', '.join(missing)}; run the survey again with `--figures`")
    changed = [name for name in manifest.changed(directory) if name in READ]
    if changed:
        message = f"{shown(directory)} holds files that were changed since they were written: {', '.join(changed)}"
        raise InputFileError(f"{message}; run the survey again")
    paths, warnings, replaced = _summary(directory / MARKER)
    if replaced:
        names = ", ".join(replaced)
        raise InputFileError(f"{shown(directory)} was flown with {names} replaced from Python; draw it there")
    prepared = prepare(load_scenario(directory / "scenario.toml"))
    place, heights = prepared.world.scene.georeference, partial(_heights, grid=prepared.truth.grid, directory=directory)
    base_m = place.origin_m[2] if place else 0.0
    truth_m = heights("truth.tif") - base_m
    if not np.allclose(truth_m, prepared.truth.surface.height_m, atol=SAME_M, equal_nan=True):
        message = f"{shown(directory)} was flown over other ground than its scenario has now: a file of it has changed"
        raise InputFileError(f"{message}; run the survey again")
    points = _read_points(directory / POINTS, place, len(prepared))
    dem = Raster(grid=prepared.truth.grid, height_m=heights("dem.tif") - base_m)

    def sigma(name: str) -> Raster | None:
        """Return the standard deviations of a raster; None if the survey has none."""
        if not (directory / name).is_file():
            return None
        return replace(dem, height_m=heights(name), quantity="standard deviation of the height")

    sensor = prepared.build_sensor()
    return Survey(
        **vars(prepared.truth.compare(dem, points, heights("lit.tif") == 1)),
        prepared=prepared,
        paths=paths,
        points=points,
        dem=dem,
        dem_sigma=sigma(SIGMA),
        dem_sigma_navigation=sigma(SIGMA_NAVIGATION),
        no_echo=heights(NO_ECHO) == 1 if (directory / NO_ECHO).is_file() else None,
        chirp=sensor.record_chirp(prepared.flight.pulses(np.array([len(prepared) // 2]))),
        warnings=warnings,
        sensor=sensor,
    )


def _summary(path: Path) -> tuple[int, tuple[str, ...], list[str]]:
    """Return the number of paths, the warnings, and the parts replaced from Python, all from `summary.json`."""
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        return int(summary["paths"]), tuple(map(str, summary["warnings"])), [*dict(summary["replaced"])]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise InputFileError(
            f"{shown(path)} is no summary of a survey ({error!r:.80}); run the survey again"
        ) from error


def _heights(name: str, *, grid: Grid, directory: Path) -> Float[np.ndarray, "row column"]:
    """Return the values of a raster of a folder, from south to north."""
    found, place = Raster.read(directory / name), grid.georeference
    east, north = place.origin_m[:2] if place else (0.0, 0.0)
    corner = found.grid.west_m - east - grid.west_m, found.grid.south_m - north - grid.south_m
    if found.grid.shape != grid.shape or np.abs(corner).max() > SAME_M:
        raise InputFileError(f"{shown(directory / name)} has other cells than its scenario; run the survey again")
    return found.height_m


def _read_points(path: Path, place: Georeference | None, pulses: int) -> Points:
    origin, axes = np.array(place.origin_m if place else (0.0, 0.0, 0.0)), ON_MAP if place else LOCAL
    try:
        header, *lines = path.read_text(encoding="utf-8").splitlines()
        names = header.split(",")
        table = np.loadtxt(lines, delimiter=",", ndmin=2) if lines else np.zeros((0, len(names)))
        column = dict(zip(names, table.T, strict=True))
        pulse, number = column["pulse"], column["echo"]
        if not (np.isfinite(table).all() and np.all((pulse >= 0) & (pulse < pulses))):
            raise ValueError("numbers that no survey has")
        return Points(
            pulse=pulse.astype(np.int64),
            number=number.astype(np.int64),
            position_m=np.column_stack([column[axis] for axis in axes]) - origin,
            origin_m=np.column_stack([column[f"radar_{axis}"] for axis in axes]) - origin,
            range_m=column["range_m"],
            range_sigma_m=column["range_sigma_m"],
            power=column["power_w"],
            echo_snr_db=column["echo_snr_db"],
            across_sigma_m=column.get("across_sigma_m"),
            ground_probability=column.get("ground_probability"),
        )
    except (ValueError, KeyError) as error:
        raise InputFileError(f"{shown(path)} is no table of points ({error!r:.80}); run the survey again") from error


def draw_figures(directory: str | Path, coordinates: Coordinates = Coordinates.MAP) -> list[Path]:
    """Draw the figures of a finished survey into its folder, as `--figures` does, and return the files.

    Rasters hold heights in single precision, so that a shade may differ. Raises InputFileError and ScenarioError as
    `read_survey`, OutputError as `write_folder`.
    """
    from sionna_radar.report.drawing import save_figures
    from sionna_radar.report.survey.figures import figures_of

    directory = Path(directory).expanduser()
    survey = read_survey(directory)
    directory = check_output(directory, MARKER)
    figures = directory / FIGURES
    if os.path.lexists(figures) and (figures.is_symlink() or not figures.is_dir()):
        raise OutputError(f"{shown(figures)} is not a folder of this result; move it away")
    earlier = read_manifest(directory / MANIFEST)
    assert earlier is not None  # `read_survey` has read it

    def fill(folder: Path) -> None:
        for name in earlier.files:
            if (directory / name).exists() and not name.startswith(f"{FIGURES}/"):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(directory / name, folder / name)
        save_figures(survey, figures_of(survey, coordinates), folder / FIGURES)

    written = write_folder(directory, MARKER, fill)
    keep_run(directory, earlier)
    return [path for path in written if path.parent.name == FIGURES]
