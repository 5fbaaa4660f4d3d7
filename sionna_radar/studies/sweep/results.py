"""The folder of a sweep: the table of all its surveys, written as CSV and Parquet, and the sweep read again.

A setting that could not be flown in full has an additional row, with its reason and no seed. The last two columns, the
costs of a survey, are the only ones that are not reproducible.
"""

import csv
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from sionna_radar.accuracy.compare import DemError
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import read_text, shown
from sionna_radar.foundation.numerics import is_number
from sionna_radar.foundation.raster import Raster
from sionna_radar.report.files.contents import csv_text
from sionna_radar.report.files.points_table import check_parquet
from sionna_radar.scenario import parse_scenario
from sionna_radar.studies.sweep import MARKER
from sionna_radar.studies.sweep.settings import Axis
from sionna_radar.studies.sweep.study import Case, Sweep
from sionna_radar.studies.sweep.trial import OWN_STATISTICS, Trial

RUNS_CSV, RUNS_PARQUET = "runs.csv", "runs.parquet"
COSTS = ("wall_s", "peak_memory_mb")
# Prefixes of the columns' names, with the errors of a trial.
KINDS = {"": "lit_error", "off_wall_": "off_wall_error", "all_cells_": "dem_error"}
MAPPED_MEANING = {
    "coverage": "share of the lit cells that the DEM fills",
    "mapped_m2": "area of the lit cells that the DEM fills, m2",
    "mapped_swath_m": "that area over the way flown, m",
    "coverage_of_swath": "share of the cells of the planned swath that are lit and filled; what the beam would sweep "
    "if it looked at every angle of its sector from every place of its track",
    "common_rms_m": "RMS error of the cells that every survey of the study lit and filled",
    "pd_wire": "share of the wires that were reported as obstacles",
    "pd_obstacle": "share of the wires, poles, fences and targets that were reported",
    "warning_s": "least time between the report of one of them and reaching it, s; 0 without a report",
    "false_alarms_per_km2": "reported obstacles that are none, over the mapped area",
    "false_alarms_per_minute": "reported obstacles that are none, over the time of flight",
}
RUNS_MEANING = {
    "run_seed": "seed of the survey",
    **MAPPED_MEANING,
    "stated_sigma_m": "root mean square of the DEM's stated standard deviation over lit cells",
    "reason": "why the setting was not flown, or not with all seeds",
    "wall_s": "time the survey took, s",
    "peak_memory_mb": "most memory of its process until then, MB",
}
Row = dict[str, Any]


def rows_of(sweep: Sweep) -> list[Row]:
    """Return the rows of the table, with values by column name; None where undefined."""
    return [row for case in sweep.cases for row in _rows(case, [axis.key for axis in sweep.axes])]


def _rows(case: Case, keys: Sequence[str]) -> list[Row]:
    setting = {key: setting_text(case.setting, key) for key in keys}
    rows = [setting | _numbers(trial) for trial in case.trials]
    if case.reason:
        rows.append(setting | _numbers(None) | {"reason": case.reason})
    return rows


def setting_text(setting: Mapping[str, Any], key: str) -> Any:
    """Return a varied value as shown in tables: the word none for a removed key, "" for an unchanged one."""
    value = setting.get(key, "")
    return "none" if value is None else value


def _numbers(trial: Trial | None) -> Row:
    row = {"run_seed": getattr(trial, "seed", None), "echoes": getattr(trial, "echoes", None)}
    for prefix, kind in KINDS.items():
        error = getattr(trial, kind, None)
        row |= {f"{prefix}{f.name}": _number(getattr(error, f.name, None)) for f in fields(DemError)}
    row |= {name: _number(getattr(trial, name, None)) for name in OWN_STATISTICS} | {"reason": None}
    return row | {name: _number(getattr(trial, name, None)) for name in COSTS}


def _number(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value


def table_text(rows: Sequence[Row]) -> str:
    """Return rows of the same columns as CSV; empty for None."""
    return csv_text(list(rows[0]) if rows else [], (row.values() for row in rows))


def write_runs_parquet(sweep: Sweep, folder: Path) -> None:
    """Write the table as Parquet; a varied key is numeric if all its values are. Raises OutputError without pyarrow."""
    check_parquet(RUNS_PARQUET)
    import pyarrow as pa
    from pyarrow.parquet import write_table

    rows = rows_of(sweep)
    columns = {name: [row[name] for row in rows] for name in (rows[0] if rows else ())}
    for axis in sweep.axes:
        columns[axis.key] = _of_one_type(columns[axis.key])
    meaning = {name: {"description": RUNS_MEANING[name]} if name in RUNS_MEANING else None for name in columns}
    arrays = {name: pa.array(values) for name, values in columns.items()}
    schema = pa.schema([pa.field(name, array.type, metadata=meaning[name]) for name, array in arrays.items()])
    table = pa.table(list(arrays.values()), schema=schema)
    write_table(table, folder / RUNS_PARQUET, compression="zstd")


def _of_one_type(values: Sequence[Any]) -> list[Any]:
    """Return values as numbers if all are, otherwise as text; "" becomes None."""
    present = [value for value in values if not isinstance(value, str) or value]
    if all(map(is_number, present)):
        integers = all(isinstance(value, int) for value in present)
        return [None if isinstance(value, str) else value if integers else float(value) for value in values]
    return [value if isinstance(value, str) else json.dumps(value) for value in values]


def map_file(folder: Path, case_number: int, seed: int, name: str) -> Path:
    """Return the file of a kept map."""
    return folder / "maps" / f"{case_number}_seed_{seed}_{name}.tif"


REMEDY = "give a folder that `sionna-radar sweep --shard` wrote"
UNKNOWN = dict.fromkeys(COSTS, float("nan"))


def read_sweep(folder: Path) -> Sweep:
    """Return the sweep in a folder; raises InputFileError for a missing or damaged one."""
    text = read_text(folder / MARKER, "sweep =", REMEDY)
    try:
        document = json.loads(text)
        costs = iter(_costs(folder))
        return Sweep(
            source=document["source"],
            axes=tuple(Axis(**{**axis, "values": tuple(axis["values"])}) for axis in document["axes"]),
            repeat=document["repeat"],
            cases=tuple(_case(case, costs, folder, n) for n, case in enumerate(document["cases"], 1)),
            interrupted=document["interrupted"],
            shard=document["shard"] or "",
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputFileError(f"{shown(folder / MARKER)} is damaged ({error}); {REMEDY}") from error


def _costs(folder: Path) -> list[dict[str, float]]:
    """Return the costs of each survey from `runs.csv`, in order; empty without that table."""
    table = folder / RUNS_CSV
    rows = csv.DictReader(io.StringIO(read_text(table, "sweep =", REMEDY) if table.exists() else "", newline=""))
    return [{name: float(row[name] or "nan") for name in COSTS} for row in rows if row["run_seed"]]


def _case(document: dict[str, Any], costs: Iterator[dict[str, float]], folder: Path, case_number: int) -> Case:
    trials = []
    for run in document["runs"]:
        trial = Trial.of_document(run | next(costs, UNKNOWN))
        error = map_file(folder, case_number, run["seed"], "error")
        trials.append(replace(trial, maps={"error": Raster.read(error)} if error.is_file() else {}))
    return Case(
        setting=document["setting"],
        scenario=parse_scenario(document["scenario"]) if document["scenario"] else None,
        trials=tuple(trials),
        reason=document["reason"] or "",
    )
