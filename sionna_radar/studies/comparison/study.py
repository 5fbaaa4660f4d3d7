"""Several results side by side: errors, differing settings, maps in the common area; and settings of a study ranked."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Raster

# Shown for settings without the key.
ABSENT = "-"
MAX_RESULTS = 12


@dataclass(frozen=True, kw_only=True)
class FlownResult:
    """Contents of a folder of results: its numbers, its settings, and its maps in map coordinates.

    name: that of the folder. summary: `summary.json`. settings: `scenario.toml`, nested tables.
    crs: of the maps; empty for local metres.
    """

    name: str
    summary: dict[str, Any]
    settings: dict[str, Any]
    crs: str
    dem: Raster
    error: Raster


@dataclass(frozen=True, kw_only=True)
class ResultsComparison:
    """Results side by side.

    differing: values by dotted key, one per result, of settings that differ between results.
    common: west, east, south, north of the area common to all maps; None without one.
    """

    results: tuple[FlownResult, ...]
    differing: dict[str, tuple[Any, ...]]
    common: tuple[float, float, float, float] | None


def compare_results(results: Sequence[FlownResult]) -> ResultsComparison:
    """Return results side by side. Raises ScenarioError for fewer than two or more than `MAX_RESULTS`."""
    if not 2 <= len(results) <= MAX_RESULTS:
        raise ScenarioError.of_option("DIR", f"{len(results)} folders; give 2 to {MAX_RESULTS} of them")
    return ResultsComparison(
        results=tuple(results),
        differing=differing_settings([result.settings for result in results]),
        common=_common(results),
    )


def differing_settings(settings: Sequence[dict[str, Any]]) -> dict[str, tuple[Any, ...]]:
    """Return the values of the dotted keys in which nested tables differ."""
    flat = [dict(_flat(tables)) for tables in settings]
    keys = sorted({key for tables in flat for key in tables})
    values = {key: tuple(tables.get(key, ABSENT) for tables in flat) for key in keys}
    return {key: row for key, row in values.items() if any(value != row[0] for value in row[1:])}


def _flat(node: Any, key: str = "") -> list[tuple[str, Any]]:
    """Return the values of nested tables, and of lists of tables, with their dotted keys."""
    if isinstance(node, dict):
        entries = node.items()
    elif isinstance(node, list) and any(isinstance(entry, dict) for entry in node):
        entries = {str(number): entry for number, entry in enumerate(node)}.items()
    else:
        return [(key, node)]
    return [pair for name, entry in entries for pair in _flat(entry, f"{key}.{name}" if key else str(name))]


def _common(results: Sequence[FlownResult]) -> tuple[float, float, float, float] | None:
    """Return the common extent of maps in one CRS; None without one."""
    if len({result.crs for result in results}) > 1:
        return None
    west, east, south, north = np.array([result.dem.grid.extent_m for result in results]).T
    box = float(west.max()), float(east.min()), float(south.max()), float(north.min())
    return box if box[0] < box[1] and box[2] < box[3] else None
