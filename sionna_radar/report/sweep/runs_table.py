"""One row for each survey of a study: what was varied, its seed, its errors, and what it took; CSV or Parquet.

A setting that could not be flown in full has a row more, with its reason and no seed. The last two columns of the CSV,
what a survey took, are the only ones that the same study does not give again.
"""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from numbers import Real
from pathlib import Path
from typing import Any

from sionna_radar.accuracy.compare import DemError
from sionna_radar.report.survey.points_table import check_parquet
from sionna_radar.studies.sweep_result import Case, Sweep, Trial

RUNS_CSV, RUNS_PARQUET = "runs.csv", "runs.parquet"
COSTS = ("wall_s", "peak_memory_mb")
# What the names of the columns begin with, by whose errors they are.
KINDS = {"": "lit_error", "off_wall_": "off_wall_error", "all_cells_": "dem_error"}
MEANING = {
    "run_seed": "seed of the survey",
    "reason": "why the setting was not flown, or not with all seeds",
    "wall_s": "time the survey took, s",
    "peak_memory_mb": "most memory of its process until then, MB",
}
Row = dict[str, Any]


def rows_of(sweep: Sweep) -> list[Row]:
    """Return the table, a value for each column by its name; None where there is none."""
    return [row for case in sweep.cases for row in _rows(case, [axis.key for axis in sweep.axes])]


def _rows(case: Case, keys: Sequence[str]) -> list[Row]:
    setting = {key: setting_text(case.setting, key) for key in keys}
    rows = [setting | _numbers(trial) for trial in case.trials]
    if case.reason:
        rows.append(setting | _numbers(None) | {"reason": case.reason})
    return rows


def setting_text(setting: Mapping[str, Any], key: str) -> Any:
    """Return a varied value as a table shows it: one that was taken out as the word none, one left alone as nothing."""
    value = setting.get(key, "")
    return "none" if value is None else value


def _numbers(trial: Trial | None) -> Row:
    found = {"run_seed": getattr(trial, "seed", None), "echoes": getattr(trial, "echoes", None)}
    for prefix, kind in KINDS.items():
        error = getattr(trial, kind, None)
        found |= {f"{prefix}{f.name}": _number(getattr(error, f.name, None)) for f in fields(DemError)}
    found["reason"] = None
    return found | {name: _number(getattr(trial, name, None)) for name in COSTS}


def _number(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value


def runs_csv(sweep: Sweep) -> str:
    """Return the table as CSV; empty for what is not there."""
    return table_text(rows_of(sweep))


def table_text(rows: Sequence[Row]) -> str:
    """Return rows of the same columns as CSV; empty for None."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def costs_of(text: str) -> list[dict[str, float]]:
    """Return what each survey of a `runs.csv` took, in order; raises ValueError or KeyError for another text."""
    rows = csv.DictReader(io.StringIO(text, newline=""))
    return [{name: float(row[name] or "nan") for name in COSTS} for row in rows if row["run_seed"]]


def write_runs_parquet(path: Path, sweep: Sweep) -> None:
    """Write the table as Parquet; a varied key is a number where all its values are, and otherwise a text.

    Raises OutputError without pyarrow.
    """
    check_parquet(path.name)
    import pyarrow as pa
    from pyarrow.parquet import write_table

    rows = rows_of(sweep)
    columns = {name: [row[name] for row in rows] for name in (rows[0] if rows else ())}
    for axis in sweep.axes:
        columns[axis.key] = _of_one_type(columns[axis.key])
    meaning = {name: {"description": MEANING[name]} if name in MEANING else None for name in columns}
    arrays = {name: pa.array(values) for name, values in columns.items()}
    schema = pa.schema([pa.field(name, array.type, metadata=meaning[name]) for name, array in arrays.items()])
    write_table(pa.table(list(arrays.values()), schema=schema), path, compression="zstd")


def _of_one_type(values: Sequence[Any]) -> list[Any]:
    """Return values as numbers, if all are, or as texts; what is left alone is None."""
    there = [value for value in values if not isinstance(value, str) or value]
    if all(isinstance(value, Real) and not isinstance(value, bool) for value in there):
        whole = all(isinstance(value, int) for value in there)
        return [None if isinstance(value, str) else value if whole else float(value) for value in values]
    return [value if isinstance(value, str) else json.dumps(value) for value in values]
