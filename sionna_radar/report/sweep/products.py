"""The folder of a sweep: its numbers as JSON and as tables, and its figure."""

import csv
import io
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Any

from sionna_radar.accuracy.compare import LE90_MEANING, DemError
from sionna_radar.foundation.versions import versions
from sionna_radar.report.folder import write_study
from sionna_radar.report.sweep.figures import draw_all
from sionna_radar.studies.sweep_result import STATISTICS, Sweep

MARKER = "sweep.json"
MEANING = {
    "cells": "lit_error: cells that the main beam reached, and all statistics without another name; off_wall_error: "
    "those of them farther than half a footprint from any wall; dem_error: all cells that the DEM fills",
    "coverage": "share of the lit cells that the DEM fills",
    "spread": "standard deviation from trial to trial (n - 1)",
    "le90_m": LE90_MEANING,
}


def write_sweep(sweep: Sweep, directory: Path) -> list[Path]:
    """Write `sweep.json`, `table.csv`, `runs.csv` and the figure, all or nothing, and return the files.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written; see `write_folder`.

    """
    tables = {"table.csv": table_csv(sweep), "runs.csv": runs_csv(sweep)}
    return write_study(directory, MARKER, summary(sweep), partial(draw_all, sweep), tables)


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
                "runs": [asdict(t) for t in case.trials],
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
    keys = [axis.key for axis in sweep.axes]
    header = [*keys, "runs", *(column for s in STATISTICS for column in (s, f"{s}_spread")), "reason"]
    rows = [
        [
            *case.setting.values(),
            len(case.trials),
            *(v for s in STATISTICS for v in (case.mean(s), case.spread(s))),
            case.reason,
        ]
        for case in sweep.cases
    ]
    return _csv(header, rows)


def runs_csv(sweep: Sweep) -> str:
    """Return one row per survey: setting, seed and every error statistic, of lit cells and of the others."""
    names = [f.name for f in fields(DemError)]
    kinds = {"": "lit_error", "off_wall_": "off_wall_error", "all_cells_": "dem_error"}
    header = [*(axis.key for axis in sweep.axes), "run_seed", "echoes"]
    header += [f"{prefix}{name}" for prefix in kinds for name in names]
    rows = [
        [
            *case.setting.values(),
            t.seed,
            t.echoes,
            *(getattr(getattr(t, kind), name, float("nan")) for kind in kinds.values() for name in names),
        ]
        for case in sweep.cases
        for t in case.trials
    ]
    return _csv(header, rows)


def _csv(header: list[str], rows: list[list[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([["" if value != value else value for value in row] for row in rows])
    return text.getvalue()
