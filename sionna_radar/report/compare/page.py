"""The page of a comparison, `compare.html`: maps that zoom together, profiles, and the errors of all results."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.report.compare.table import ERRORS, error_rows, setting_rows
from sionna_radar.report.folder import write_folder, write_text
from sionna_radar.report.page import markup
from sionna_radar.report.page.document import document
from sionna_radar.report.page.packing import Pack
from sionna_radar.report.page.relief import HEIGHT_STEP_M, packed_map, thinned
from sionna_radar.report.page.world import colour_scales
from sionna_radar.studies.comparison import Comparison, FlownResult

MARKER = "compare.html"
# All maps of a page together.
MOST_CELLS = 1_600_000
LINES, LINE_POINTS = 41, 400
BINS = 81
LOCAL = {"east": "East (m)", "north": "North (m)", "height": "Height (m)"}
MAP = {"east": "Easting (m)", "north": "Northing (m)", "height": "Height (m)"}


def write_comparison(result: Comparison, directory: Path) -> list[Path]:
    """Write `compare.html` into a directory, all or nothing, and return the files.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written; see `write_folder`.

    """
    return write_folder(directory, MARKER, partial(_fill, result))


def _fill(result: Comparison, directory: Path) -> None:
    write_text(directory / MARKER, comparison_page(result))


def comparison_page(result: Comparison) -> str:
    """Return the page of a comparison as HTML."""
    pack = Pack()
    one_map = len({one.crs for one in result.results}) == 1
    axes = MAP if one_map and result.results[0].crs else LOCAL
    maps, notes = _maps(result, pack, axes["height"])
    numbers = {
        "frame": {"origin": (0.0, 0.0, 0.0), **axes},
        "scales": colour_scales(),
        "maps": maps,
        "linked": one_map,
        "profiles": _profiles(result, pack),
        "histogram": _histogram(result),
        "results": [
            {"name": one.name, "lit_error": one.summary["lit_error"], "dem_error": one.summary["dem_error"]}
            for one in result.results
        ],
    }
    title = f"{len(result.results)} results side by side"
    return document(title, _body(result, title, notes), pack.text(numbers), ("maps.js", "chirps.js", "compare.js"))


def _limits(dems: Sequence[Float[np.ndarray, "row column"]]) -> tuple[float, float]:
    """Return the lowest and the highest of some heights, with a least difference."""
    known = np.concatenate([dem[np.isfinite(dem)] for dem in dems])
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    return (low, high) if high - low > 1e-3 else (low - 0.5, low + 0.5)


def _maps(result: Comparison, pack: Pack, height: str) -> tuple[list[dict[str, Any]], list[str]]:
    """Return DEM and error of each result on one scale, heights of different ground on scales of their own.

    Also returns what was left out.
    """
    dems = [one.dem.height_m for one in result.results]
    errors = np.concatenate([np.abs(one.error.height_m[one.error.filled]) for one in result.results])
    limit = max(float(np.percentile(errors, 99)), 1e-3) if errors.size else 1.0
    wrong = {"low": -limit, "high": limit, "scale": "error", "unit": "DEM minus truth (m)", "hover": "error"}
    maps, notes = [], []
    for one in result.results:
        low, high = _limits(dems if result.common else [one.dem.height_m])
        heights = {"low": low, "high": high, "scale": "height", "unit": height, "hover": "height"}
        thin = thinned(one.dem.grid, MOST_CELLS // (2 * len(result.results)))
        for name, values, look in (("DEM", one.dem.height_m, heights), ("error", one.error.height_m, wrong)):
            placed = packed_map(pack, thin.cells, thin.of(values), HEIGHT_STEP_M, (0.0, 0.0))
            maps.append({"name": f"{one.name}: {name}", **look, **placed})
        if thin.note:
            notes.append(f"{one.name}: {thin.note}.")
    return maps, notes


def _profiles(result: Comparison, pack: Pack) -> dict[str, Any] | None:
    """Return heights and errors along lines from west to east over the ground that all maps cover."""
    if result.common is None:
        return None
    west, east, south, north = result.common
    inset = 0.02 * (north - south)
    x, y = np.linspace(west, east, LINE_POINTS), np.linspace(south + inset, north - inset, LINES)
    across, along = np.meshgrid(x, y)
    places = np.column_stack([across.ravel(), along.ravel()])

    def lines(one: FlownResult) -> tuple[dict[str, Any], dict[str, Any]]:
        height, error = (raster.at(places).reshape(across.shape) for raster in (one.dem, one.error))
        return pack.rounded(height, HEIGHT_STEP_M), pack.rounded(error, HEIGHT_STEP_M)

    found = [lines(one) for one in result.results]
    return {
        "x": (x).tolist(),
        "y": y.tolist(),
        "names": [one.name for one in result.results],
        "height": [height for height, _ in found],
        "error": [error for _, error in found],
    }


def _histogram(result: Comparison) -> dict[str, Any]:
    """Return the shares of all filled cells by their error."""
    values = [one.error.height_m[one.error.filled] for one in result.results]
    together = np.abs(np.concatenate(values))
    limit = 1.3 * max(float(np.percentile(together, 99)), 1e-3) if together.size else 1.0
    edges, percent = np.linspace(-limit, limit, BINS + 1), np.arange(100)
    return {
        "edges": edges.tolist(),
        "percent": percent.tolist(),
        "series": [
            {
                "name": one.name,
                "share": (100 * np.histogram(own, edges)[0] / max(len(own), 1)).tolist(),
                "below": np.percentile(np.abs(own), percent).tolist() if len(own) else [],
                "marks": [(m, float(np.percentile(np.abs(own), m))) for m in (68.27, 90.0, 95.0)] if len(own) else [],
            }
            for one, own in zip(result.results, values, strict=True)
        ],
    }


def _body(result: Comparison, title: str, notes: list[str]) -> str:
    keys = [key for key, _ in ERRORS.values()]
    rows: list[list[markup.Cell | str]] = []
    for number, (one, texts) in enumerate(zip(result.results, error_rows(result).values(), strict=True)):
        cells = [
            markup.Cell(text=text, key=f"{number}.lit_error.{key}", value=one.summary["lit_error"][key])
            for key, text in zip(keys, texts, strict=True)
        ]
        rows.append([one.name, *cells])
    settings = [[key, *values] for key, values in setting_rows(result).items()]
    names = [one.name for one in result.results]
    differing = (
        markup.table(["Key", *names], settings, style="text")
        if settings
        else markup.paragraph("No setting differs.", "note")
    )
    rooms = "".join(markup.map_room(number) for number in range(2 * len(names)))
    zooming = "Scroll to zoom, drag to move; " + (
        "all maps follow one another. " if result.common else "there is no ground that all maps show. "
    )
    profiles = (
        [
            markup.controls(markup.slider("line", "Line", LINES - 1, LINES // 2)),
            markup.plot("profile", "chart"),
            markup.plot("profile-error", "chart"),
        ]
        if result.common
        else [markup.paragraph("No ground is covered by all maps in one CRS, so that there is no profile.", "note")]
    )
    charts = f'<div class="grid small">{markup.plot("histogram", "chart")}{markup.plot("within", "chart")}</div>'
    sections = [
        markup.section(
            "errors",
            "Errors",
            markup.table(["DEM minus truth of lit cells (m)", *ERRORS], rows),
            charts,
            markup.paragraph("Curves: all cells that a DEM fills, lit or not.", "note"),
        ),
        markup.section("settings", "Settings that differ", differing),
        markup.section(
            "maps",
            "Maps",
            markup.paragraph(zooming + " ".join(notes), "note"),
            f'<div class="grid">{rooms}</div>',
        ),
        markup.section("profiles", "Profiles from west to east", *profiles),
    ]
    links = {"errors": "Errors", "settings": "Settings that differ", "maps": "Maps", "profiles": "Profiles"}
    return markup.head("Comparison", title, links) + "\n".join(sections)
