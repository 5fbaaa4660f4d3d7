"""The folder of a sweep: its numbers as JSON and as tables, and its figure."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sionna_radar.accuracy.compare import LE90_MEANING
from sionna_radar.foundation.versions import versions
from sionna_radar.report.folder import strict_json, write_folder, write_text
from sionna_radar.report.sweep.figures import draw_all
from sionna_radar.report.sweep.runs_file import RUNS_FILES, RunsFile
from sionna_radar.report.sweep.runs_table import (
    COSTS,
    RUNS_CSV,
    RUNS_PARQUET,
    Row,
    runs_csv,
    setting_text,
    table_text,
    write_runs_parquet,
)
from sionna_radar.studies.sweep_result import STATISTICS, Case, Sweep, Trial

MARKER = "sweep.json"
MEANING = {
    "cells": "lit_error: cells that the main beam reached, and all statistics without another name; off_wall_error: "
    "those of them farther than half a footprint from any wall; dem_error: all cells that the DEM fills",
    "coverage": "share of the lit cells that the DEM fills",
    "spread": "standard deviation from trial to trial (n - 1)",
    "le90_m": LE90_MEANING,
}


def write_sweep(sweep: Sweep, directory: Path, runs: Sequence[RunsFile] = RUNS_FILES) -> list[Path]:
    """Write `sweep.json`, `table.csv`, a table of all surveys and the figures, all or nothing, and return the files.

    Parameters
    ----------
    sweep:
        The study.
    directory:
        Output folder; only the files of an earlier result in it are replaced.
    runs:
        Formats of the table with a row for each survey.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written (see `write_folder`), or Parquet without pyarrow.

    """

    def fill(folder: Path) -> None:
        write_text(folder / MARKER, strict_json(summary(sweep)))
        write_text(folder / "table.csv", table_csv(sweep))
        if RunsFile.CSV in runs:
            write_text(folder / RUNS_CSV, runs_csv(sweep))
        if RunsFile.PARQUET in runs:
            write_runs_parquet(folder / RUNS_PARQUET, sweep)
        draw_all(sweep, folder / "figures")

    return write_folder(directory, MARKER, fill)


def summary(sweep: Sweep) -> dict[str, Any]:
    """Return the study as one JSON document, strict except for NaN."""
    return {
        "source": sweep.source,
        "axes": [asdict(axis) for axis in sweep.axes],
        "repeat": sweep.repeat,
        "interrupted": sweep.interrupted,
        "shard": sweep.shard or None,
        "meaning": MEANING,
        "cases": [
            {
                "setting": case.setting,
                "reason": case.reason or None,
                "statistics": {s: {"mean": case.mean(s), "spread": case.spread(s)} for s in STATISTICS},
                "runs": [_document(trial) for trial in case.trials],
                "scenario": case.scenario.model_dump(mode="json") if case.scenario else None,
            }
            for case in sweep.cases
        ],
        "versions": versions(),
    }


def table_csv(sweep: Sweep) -> str:
    """Return one row per case: the setting, the mean of each statistic and its spread; empty for NaN.

    The errors are those of lit cells unless the column name says otherwise.
    """
    return table_text([_row(case, sweep) for case in sweep.cases])


def _row(case: Case, sweep: Sweep) -> Row:
    row: Row = {axis.key: setting_text(case.setting, axis.key) for axis in sweep.axes}
    row["runs"] = len(case.trials)
    for statistic in STATISTICS:
        row |= {statistic: case.mean(statistic), f"{statistic}_spread": case.spread(statistic)}
    return {name: "" if value != value else value for name, value in row.items()} | {"reason": case.reason}


def _document(trial: Trial) -> dict[str, Any]:
    """Return a trial without what it took, which would differ from run to run."""
    return {name: value for name, value in asdict(trial).items() if name not in COSTS}
