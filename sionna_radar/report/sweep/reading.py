"""Reading the folder of a sweep back, to merge shards."""

import json
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

from sionna_radar.accuracy.compare import DemError
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import read_text, shown
from sionna_radar.report.sweep.products import MARKER
from sionna_radar.report.sweep.runs_table import COSTS, RUNS_CSV, costs_of
from sionna_radar.scenario import parse_scenario
from sionna_radar.studies.design import Axis
from sionna_radar.studies.sweep_result import Case, Sweep, Trial

REMEDY = "give a folder that `sionna-radar sweep --shard` wrote"
UNKNOWN = dict.fromkeys(COSTS, float("nan"))


def read_sweep(folder: Path) -> Sweep:
    """Return the sweep in a folder; raises InputFileError for a folder that holds none, or a damaged one."""
    text = read_text(folder / MARKER, "sweep =", REMEDY)
    try:
        document = json.loads(text)
        costs = iter(_costs(folder))
        return Sweep(
            source=document["source"],
            axes=tuple(Axis(**{**axis, "values": tuple(axis["values"])}) for axis in document["axes"]),
            repeat=document["repeat"],
            cases=tuple(_case(case, costs) for case in document["cases"]),
            interrupted=document["interrupted"],
            shard=document["shard"] or "",
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        message = f"{shown(folder / MARKER)} is damaged ({error}); {REMEDY}"
        raise InputFileError(message) from error


def _costs(folder: Path) -> list[dict[str, float]]:
    """Return what the surveys took, from the table that a user may have left out."""
    table = folder / RUNS_CSV
    return costs_of(read_text(table, "sweep =", REMEDY)) if table.exists() else []


def _case(found: dict[str, Any], costs: Iterator[dict[str, float]]) -> Case:
    return Case(
        setting=found["setting"],
        scenario=parse_scenario(found["scenario"]) if found["scenario"] else None,
        trials=tuple(_trial(run | next(costs, UNKNOWN)) for run in found["runs"]),
        reason=found["reason"] or "",
    )


def _trial(found: dict[str, Any]) -> Trial:
    names = [field.name for field in fields(DemError)]
    errors = {
        kind: {name: float("nan") if found[kind][name] is None else found[kind][name] for name in names}
        if found[kind]
        else None
        for kind in ("dem_error", "lit_error", "off_wall_error")
    }
    return Trial.of_document({**found, **errors})
