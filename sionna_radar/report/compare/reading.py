"""Reading a folder of results: its numbers, its settings and its rasters, bounded, and refused in one sentence."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import parse_toml, read_text, shown
from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.raster_file import open_raster, read_square_cells
from sionna_radar.studies.comparison import FlownResult

REMEDY = "give a folder that `sionna-radar run` or `process` wrote, with the error of its DEM"
# The numbers and the settings in a folder of each command.
FLOWN, PROCESSED = ("summary.json", "scenario.toml"), ("processed.json", "settings.toml")
# Cells of the largest DEM that a survey makes.
MOST_CELLS = 25_000_000
ERRORS = ("lit_error", "dem_error")
NUMBERS = ("rms_m", "mean_m", "std_m", "nmad_m", "le90_m", "min_m", "max_m", "count", "coverage")


def read_results(folders: Sequence[Path]) -> list[FlownResult]:
    """Return the results of some folders, each named by as much of its path as tells it from the others.

    Raises InputFileError for a folder that holds none, or whose files are damaged.
    """
    names = _names(folders)
    return [read_result(folder, name) for folder, name in zip(folders, names, strict=True)]


def read_result(folder: Path, name: str) -> FlownResult:
    """Return the result in a folder."""
    numbers, tables = PROCESSED if (folder / PROCESSED[0]).is_file() else FLOWN
    summary = _summary(folder / numbers)
    settings = _settings(folder / tables)
    crs, dem = _raster(folder / "dem.tif")
    _, error = _raster(folder / "error.tif")
    if dem.grid != error.grid:
        message = f"{shown(folder)}: dem.tif and error.tif have different cells; {REMEDY}"
        raise InputFileError(message)
    return FlownResult(name=name, summary=summary, settings=settings, crs=crs, dem=dem, error=error)


def _names(folders: Sequence[Path]) -> list[str]:
    parts = [folder.absolute().parts for folder in folders]
    for length in range(1, max(map(len, parts), default=1) + 1):
        names = ["/".join(part[-length:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{names[0]} ({number})" for number in range(1, len(folders) + 1)] if folders else []


def _summary(path: Path) -> dict[str, Any]:
    text = read_text(path, "summary =", REMEDY)
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        message = f"summary = {shown(path)} is not JSON ({error}); {REMEDY}"
        raise InputFileError(message) from None
    for key in ERRORS:
        errors = document.get(key) if isinstance(document, dict) else None
        if not isinstance(errors, dict) or not all(_number(errors.get(name, "")) for name in NUMBERS):
            message = f"summary = {shown(path)} has no {key} of a survey; {REMEDY}"
            raise InputFileError(message)
    return document


def _number(value: Any) -> bool:
    """Whether a value is a number or null."""
    if value is None:
        return True
    return (
        isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300 and math.isfinite(value)
    )


def _settings(path: Path) -> dict[str, Any]:
    text = read_text(path, "scenario =", REMEDY)
    try:
        return parse_toml(text)
    except ValueError as error:
        message = f"scenario = {shown(path)} is not TOML ({error}); {REMEDY}"
        raise InputFileError(message) from None


def _raster(path: Path) -> tuple[str, Raster]:
    """Return the CRS and the heights of a raster, rows from south to north."""
    with open_raster(path, "raster") as file:
        cells = read_square_cells(file, f"raster = {shown(path)}", REMEDY, MOST_CELLS)
        crs = file.crs.to_wkt() if file.crs else ""
    raster = Raster.from_array(cells.height_m, cells.spacing_m, west_m=cells.west_m, south_m=cells.south_m)
    return crs, raster
