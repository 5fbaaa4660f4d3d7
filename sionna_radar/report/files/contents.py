"""Contents of a folder of results: kinds of files and their selection, JSON and text."""

import csv
import io
import json
import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum, StrEnum
from pathlib import Path
from typing import Any

from sionna_radar.foundation.errors import OutputError

logger = logging.getLogger("sionna_radar")

# The file that identifies such a folder.
MARKER = "summary.json"
# Run times and memory, which differ from run to run.
COSTS = "costs.json"


class Report(Enum):
    """Selection of the page `report.html` in a folder of results."""

    PAGE = "page"
    NONE = "none"


class PointsFile(StrEnum):
    """Formats of the points of a survey.

    Examples
    --------
    >>> from pathlib import Path
    >>> survey = run(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> files = write_survey(survey, Path("results"), points=[PointsFile.CSV])
    >>> [file.name for file in files if file.stem == "points"]
    ['points.csv']
    """

    LAZ = "laz"
    CSV = "csv"
    PARQUET = "parquet"


# CSV too, for users without a LAZ reader; it takes 4 s per million points.
POINTS_FILES = (PointsFile.LAZ, PointsFile.CSV)


class RunsFile(StrEnum):
    """Formats of the table with one row per survey."""

    CSV = "csv"
    PARQUET = "parquet"


RUNS_FILES = (RunsFile.CSV,)


class Keep(StrEnum):
    """Maps of a sweep that are kept as files."""

    NONE = "none"
    BEST = "best"
    ALL = "all"


def costs_json(timing_s: Mapping[str, float], peak_memory_mb: float) -> str:
    """Return the text of `COSTS`: run times, s, and peak memory, MB."""
    return strict_json({"timing_s": dict(timing_s), "peak_memory_mb": peak_memory_mb})


def write_text(path: Path, text: str) -> None:
    """Write text as UTF-8 with line feeds on every system."""
    path.write_text(text, encoding="utf-8", newline="\n")


def write_page(path: Path, page: Callable[[], str]) -> None:
    """Write a page; one that cannot be made does not keep the results from being written."""
    try:
        write_text(path, page())
    except OutputError as error:
        logger.warning("no %s: %s", path.name, error)


def strict_json(document: Mapping[str, Any]) -> str:
    """Return a document as strict JSON text; NaN and infinities become null."""
    return json.dumps(without_nan(document), indent=2, allow_nan=False) + "\n"


def without_nan(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document with every NaN and infinity replaced by None."""
    return {key: _without_nan(entry) for key, entry in document.items()}


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return without_nan(value)
    if isinstance(value, list | tuple):
        return [_without_nan(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def csv_text(columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a table as CSV; an empty cell for None."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()
