"""A sweep as files and tables."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from sionna_radar.accuracy.compare import LE90_MEANING
from sionna_radar.execution.workers import versions
from sionna_radar.report.files.contents import RUNS_FILES, Keep, RunsFile
from sionna_radar.report.study_document import Column, StudyDocument
from sionna_radar.report.survey.summary import better_map
from sionna_radar.report.terminal import number, table_of, with_spread
from sionna_radar.studies.sweep import MARKER
from sionna_radar.studies.sweep.common_cells import unequal_areas
from sionna_radar.studies.sweep.figures import SINGLE, figures_of
from sionna_radar.studies.sweep.ranking import COLUMNS, Ranking, ranked
from sionna_radar.studies.sweep.results import (
    COSTS,
    MAPPED_MEANING,
    RUNS_CSV,
    Row,
    map_file,
    rows_of,
    setting_text,
    table_text,
    write_runs_parquet,
)
from sionna_radar.studies.sweep.settings import label, short
from sionna_radar.studies.sweep.study import Case, Sweep
from sionna_radar.studies.sweep.trial import MAPS, OBSTACLE_STATISTICS, STATISTICS, Trial

METHOD = "dem.method"
UNRANKED = Ranking()
MEANING = {
    "cells": "lit_error: cells that the main beam reached, and all statistics without another name; off_wall_error: "
    "those of them farther than half a footprint from any wall; dem_error: all cells that the DEM fills",
    **MAPPED_MEANING,
    "spread": "standard deviation from trial to trial (n - 1)",
    "le90_m": LE90_MEANING,
}


def write_maps(sweep: Sweep, folder: Path, ranking: Ranking, keep: Keep) -> None:
    """Write the kept maps of a sweep that holds them into `maps/`; see `sweep_document`."""
    kept = _kept(sweep, ranking, keep)
    for case_number, case in enumerate(sweep.cases, 1):
        names = MAPS if case in kept else ("error",) if sweep.shard else ()
        for trial in case.trials:
            for name in names:
                if name in trial.maps:
                    path = map_file(folder, case_number, trial.seed, name)
                    path.parent.mkdir(exist_ok=True)
                    trial.maps[name].to_geotiff(path)


def _kept(sweep: Sweep, ranking: Ranking, keep: Keep) -> Sequence[Case]:
    flown = [case for case, _ in ranked(sweep, ranking) if case.trials]
    if keep is not Keep.BEST:
        return flown if keep is Keep.ALL else []
    compared = all(np.isfinite(case.mean("common_rms_m")) for case in flown)
    least = "common_rms_m" if compared else "rms_m"
    return flown[:1] if ranking.sort else sorted(flown, key=lambda case: case.mean(least))[:1]


def sweep_numbers(sweep: Sweep) -> dict[str, Any]:
    """Return the numbers."""
    return {
        "source": sweep.source,
        "axes": sweep.axes,
        "repeat": sweep.repeat,
        "interrupted": sweep.interrupted,
        "shard": sweep.shard or None,
        "meaning": MEANING,
        "notes": [note for note in [_unequal(sweep)] if note],
        "cases": [
            {
                "setting": case.setting,
                "reason": case.reason or None,
                "statistics": {s: {"mean": case.mean(s), "spread": case.spread(s)} for s in STATISTICS},
                "runs": [_document(trial) for trial in case.trials],
                "scenario": case.scenario,
            }
            for case in sweep.cases
        ],
        "versions": versions(),
    }


def table_csv(sweep: Sweep, ranking: Ranking = UNRANKED) -> str:
    """Return one row per case, ranked: setting, means over lit cells and their spreads, judgements; empty for NaN."""
    return table_text([_row(case, judged, sweep) for case, judged in ranked(sweep, ranking)])


def _row(case: Case, judged: Mapping[str, Any], sweep: Sweep) -> Row:
    row: Row = {axis.key: setting_text(case.setting, axis.key) for axis in sweep.axes}
    row["runs"] = len(case.trials)
    for statistic in STATISTICS:
        row |= {statistic: case.mean(statistic), f"{statistic}_spread": case.spread(statistic)}
        if np.isfinite(bounds := case.interval(statistic)).all():
            row |= {f"{statistic}_low": bounds[0], f"{statistic}_high": bounds[1]}
    row |= {METHOD if name == "method" else name: value for name, value in judged.items() if name not in row}
    return {name: "" if value != value else value for name, value in row.items()} | {"reason": case.reason}


def _document(trial: Trial) -> dict[str, Any]:
    """Return a trial without its costs, which differ from run to run."""
    return {name: value for name, value in asdict(replace(trial, maps={})).items() if name not in (*COSTS, "maps")}


def _rate(key: str, heading: str, form: str) -> Column[Case]:
    def text(case: Case) -> str:
        low, high = case.interval(key)
        shown = f"{case.mean(key):{form}}"
        return f"{shown} ({low:{form}} to {high:{form}})" if high == high else shown

    return Column(key=key, heading=heading, form=form, text=text)


def _statistic(key: str, heading: str, form: str = ".3f") -> Column[Case]:
    return Column(
        key=key, heading=heading, form=form, text=lambda case: with_spread(case.mean(key), case.spread(key), form)
    )


# Statistics of a setting in tables.
COLUMNS_OF_CASES = (
    _statistic("rms_m", "RMS"),
    _statistic("mean_m", "mean", "+.3f"),
    _statistic("std_m", "std"),
    _statistic("nmad_m", "NMAD"),
    _statistic("le90_m", "LE90"),
    _statistic("min_m", "min", "+.3f"),
    _statistic("max_m", "max", "+.3f"),
    _statistic("coverage", "coverage of lit cells", ".1%"),
    _statistic("mapped_m2", "mapped m2", ",.0f"),
    _statistic("coverage_of_swath", "coverage of swath", ".1%"),
    _statistic("off_wall_rms_m", "RMS off walls"),
    _statistic("all_cells_rms_m", "RMS all cells"),
    _statistic("stated_sigma_m", "stated sigma"),
    _statistic("common_rms_m", "RMS common cells"),
    _rate("pd_wire", "Pd of wires", ".3f"),
    _rate("pd_obstacle", "Pd of obstacles", ".3f"),
    _statistic("warning_s", "warning s", ".1f"),
    _rate("false_alarms_per_km2", "false alarms per km2", ".3g"),
    _rate("false_alarms_per_minute", "per minute", ".2g"),
)
# Largest number of settings shown in a terminal; the files have all.
MAX_ROWS = 60
# Shown only where a case has them.
OPTIONAL = ("coverage_of_swath", "off_wall_rms_m", "stated_sigma_m", "common_rms_m", *OBSTACLE_STATISTICS)


def sentences(result: Sweep) -> list[str]:
    """Return the omissions of the table, the comparisons of its settings, and the warnings of each."""
    hidden = len(result.cases) - MAX_ROWS
    found = [f"and {hidden:,} more settings in table.csv"] if hidden > 0 else []
    found += [unequal] if (unequal := _unequal(result)) else []
    flown = [(case.scenario, case.trials[0]) for case in result.cases if case.scenario and case.trials]
    better = [better_map(scenario, trial.lit_error, trial.off_wall_error) for scenario, trial in flown]
    if any(better) and METHOD not in [axis.key for axis in result.axes]:
        found.append(f"hint: {max(better)}; another setting may be the best with it: --set {METHOD}=refined")
    return found + [
        f"{label(case.setting)}: {note}"
        for case in result.cases[:MAX_ROWS]
        for note in ([case.reason] if case.reason else []) + _warnings(case)
    ]


def _unequal(sweep: Sweep) -> str:
    """Return the sentence about settings that map unequal areas, and what compares them; "" if they do not."""
    unequal = unequal_areas([(label(case.setting), case.mean("mapped_m2")) for case in sweep.cases])
    compared = any(np.isfinite(case.mean("common_rms_m")) for case in sweep.cases)
    remedy = "compare common_rms_m, that of the same cells" if compared else "compare those of equal coverage_of_swath"
    return f"{unequal}: {remedy}" if unequal else ""


def sweep_table(result: Sweep, ranking: Ranking = UNRANKED) -> Table:
    """Return one row per case, ranked: mean and spread of each statistic, judgements, and quantities that differ."""
    trials = f"mean of {result.repeat} trials ± their standard deviation" if result.repeat > 1 else SINGLE
    title = f"{result.source}: elevation error of lit cells in metres, {trials}"
    columns = [
        column
        for column in COLUMNS_OF_CASES
        if column.key not in OPTIONAL or any(np.isfinite(case.mean(column.key)) for case in result.cases)
    ]
    cases, varied = ranked(result, ranking), [axis.key for axis in result.axes]
    same = [n for n in COLUMNS if len({judged[n] for _, judged in cases if judged[n] == judged[n]}) < 2]
    hidden = {*same, *(["method"] if METHOD in varied else [])}
    names = [name for name in (cases[0][1] if cases else ()) if name not in hidden]
    heads = (
        *(str(column.heading) for column in columns),
        *("DEM method" if name == "method" else name for name in names),
    )
    rows = []
    for case, judged in cases[:MAX_ROWS]:
        setting = (short(setting_text(case.setting, key)) for key in varied)
        statistics = (column.shown(case) for column in columns)
        rows.append([*setting, *statistics, *(_judgement(judged[name]) for name in names)])
    return table_of(title, [*varied, *heads], rows)


def _judgement(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else ""
    return value if isinstance(value, str) else number(value, ".3g")


def _warnings(case: Case) -> list[str]:
    """Return the warnings of a case, from the first seed with any."""
    return list(next((t.warnings for t in case.trials if t.warnings), ()))


def sweep_document(
    runs: Collection[RunsFile] = RUNS_FILES, ranking: Ranking = UNRANKED, keep: Keep = Keep.NONE
) -> StudyDocument[Sweep]:
    """Return the document of a sweep: `sweep.json`, `table.csv`, a table of all surveys, figures and maps.

    runs: formats of the table with one row per survey; Parquet needs pyarrow.
    ranking: order and judgement of the settings in the tables.
    keep: maps to write into `maps/`, of a sweep that holds them: those of the first setting in the order of the ranking
        (without one, of the least RMS error over common cells), or all. Of a shard the errors of all, which `merge`
        compares.
    """
    csv = {RUNS_CSV: lambda sweep: table_text(rows_of(sweep))} if RunsFile.CSV in runs else {}
    return StudyDocument(
        marker=MARKER,
        suffix="_sweep",
        numbers=sweep_numbers,
        tables=lambda sweep: [sweep_table(sweep, ranking)],
        lines=sentences,
        figures=figures_of,
        notebook=["sweep"],
        texts={"table.csv": partial(table_csv, ranking=ranking), **csv},
        files=[
            *([write_runs_parquet] if RunsFile.PARQUET in runs else []),
            partial(write_maps, ranking=ranking, keep=keep),
        ],
    )


DOCUMENT = sweep_document()
