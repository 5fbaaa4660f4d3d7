"""Contents of a folder of results: kinds of files and their selection, JSON and text."""

import csv
import io
import json
import logging
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum, StrEnum
from pathlib import Path
from typing import Any

from sionna_radar.foundation.errors import OutputError

logger = logging.getLogger("sionna_radar")

# The file that identifies such a folder.
MARKER = "summary.json"
# Run times and memory, which differ from run to run.
COSTS = "costs.json"
# The folder of figures.
FIGURES = "figures"


class Report(Enum):
    """Selection of the page `report.html` in a folder of results."""

    PAGE = "page"
    NONE = "none"


class Figures(Enum):
    """Selection of the figures in a folder of results: PNG files, or none; they are slow to draw."""

    PNG = "png"
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
    """Return the text of `COSTS`: run times, s, peak memory, MB, and whether Python kept its compiled modules."""
    costs = {"timing_s": dict(timing_s), "peak_memory_mb": peak_memory_mb}
    return strict_json({**costs, "byte_code_kept": not sys.dont_write_bytecode})


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
    """Return a document as strict JSON text; see `jsonable`."""
    return json.dumps(jsonable(document), indent=2, allow_nan=False) + "\n"


def jsonable(value: Any) -> Any:
    """Return a value as strict JSON holds it; NaN and infinities are None.

    Mappings, dataclasses by their fields, and tables of scenarios become objects; sequences and arrays become lists.
    """
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: jsonable(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [jsonable(entry) for entry in value]
    if is_dataclass(value):
        return {field.name: jsonable(getattr(value, field.name)) for field in fields(value)}
    # NumPy and pydantic are slow to import, and not needed by all commands.
    if hasattr(value, "tolist"):
        return jsonable(value.tolist())
    return jsonable(value.model_dump(mode="json")) if hasattr(value, "model_dump") else value


def csv_text(columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a table as CSV; an empty cell for None."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()
