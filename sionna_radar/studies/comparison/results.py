"""Reading folders of results: their documents and their rasters."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import is_file, parse_toml, read_text, shown
from sionna_radar.foundation.numerics import is_number
from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.raster_file import open_raster, read_square_cells
from sionna_radar.studies.comparison.study import FlownResult, ResultsComparison, compare_results

# Cells of the largest DEM of a survey.
RESULT_MAX_CELLS = 25_000_000
REMEDY = "give a folder that `sionna-radar run` or `process` wrote, with the error of its DEM"


def folder_names(folders: Sequence[Path]) -> list[str]:
    """Return the shortest unique end of each path."""
    parts = [folder.absolute().parts for folder in folders]
    for length in range(1, max(map(len, parts), default=1) + 1):
        names = ["/".join(path[-length:]) for path in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{names[0]} ({number})" for number in range(1, len(folders) + 1)] if folders else []


def read_document(path: Path, what: str = "summary") -> Any:
    """Return a JSON or TOML document of a result; raises InputFileError, which names it, if it cannot be read."""
    text = read_text(path, f"{what} =", REMEDY)
    form = path.suffix[1:].upper()
    try:
        return json.loads(text) if form == "JSON" else parse_toml(text)
    except (ValueError, RecursionError) as error:
        raise InputFileError(f"{what} = {shown(path)} is not {form} ({error}); {REMEDY}") from None


def read_raster(path: Path) -> tuple[str, Raster]:
    """Return the CRS and the heights of a raster, rows from south to north."""
    with open_raster(path, "raster") as file:
        cells = read_square_cells(file, f"raster = {shown(path)}", REMEDY, RESULT_MAX_CELLS)
        crs = file.crs.to_wkt() if file.crs else ""
    raster = Raster.from_array(cells.height_m, cells.spacing_m, west_m=cells.west_m, south_m=cells.south_m)
    return crs, raster


# The numbers and the settings in a folder of each command.
FLOWN, PROCESSED = ("summary.json", "scenario.toml"), ("processed.json", "settings.toml")
RESULT_ERRORS = ("lit_error", "dem_error")
NUMBERS = ("rms_m", "mean_m", "std_m", "nmad_m", "le90_m", "min_m", "max_m", "count", "coverage")


def read_results(folders: Sequence[Path]) -> list[FlownResult]:
    """Return the results of folders, named by the shortest unique ends of their paths; InputFileError for others."""
    return [_result(folder, name) for folder, name in zip(folders, folder_names(folders), strict=True)]


def _result(folder: Path, name: str) -> FlownResult:
    numbers, tables = PROCESSED if is_file(folder / PROCESSED[0]) else FLOWN
    summary = _summary(folder / numbers)
    settings = read_document(folder / tables, "scenario")
    crs, dem = read_raster(folder / "dem.tif")
    _, error = read_raster(folder / "error.tif")
    if dem.grid != error.grid:
        raise InputFileError(f"{shown(folder)}: dem.tif and error.tif have different cells; {REMEDY}")
    return FlownResult(name=name, summary=summary, settings=settings, crs=crs, dem=dem, error=error)


def _summary(path: Path) -> dict[str, Any]:
    document = read_document(path)
    for key in RESULT_ERRORS:
        errors = document.get(key) if isinstance(document, dict) else None
        if not isinstance(errors, dict) or not all(_number(errors.get(name, "")) for name in NUMBERS):
            raise InputFileError(f"summary = {shown(path)} has no {key} of a survey; {REMEDY}")
    return document


def _number(value: Any) -> bool:
    """Return True if a value is a finite number or null."""
    # abs(NaN) < x is false, too.
    return value is None or (is_number(value) and abs(value) < 1e300)


def compare(folders: Sequence[str | Path]) -> ResultsComparison:
    """Compare the results of several surveys: errors, differing settings, and maps over their common area.

    Parameters
    ----------
    folders:
        Folders that `run` or `process` wrote.

    Returns
    -------
    The results side by side: errors in metres over each map and over the area common to all.

    Raises
    ------
    InputFileError
        A folder holds no result, or damaged files.
    ScenarioError
        There are fewer than two folders, or more than a page can show.

    Examples
    --------
    >>> from pathlib import Path
    >>> survey = run(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> for name in ("first", "second"):
    ...     files = write_survey(survey, Path(name))
    >>> compare(["first", "second"]).differing
    {}
    """
    return compare_results(read_results([Path(folder) for folder in folders]))
