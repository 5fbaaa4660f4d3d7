"""Reading folders of results: their names, their documents and their rasters."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import parse_toml, read_text, shown
from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.raster_file import open_raster, read_square_cells

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
