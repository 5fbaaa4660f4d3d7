"""A sweep as files, tables and a figure, and the reader of its table of runs.

The figure shows the DEM error against the varied parameters, with the spread over the trials. A setting that could not
be flown in full has an additional row, with its reason and no seed. The last two columns of the CSV, the costs of a
survey, are the only ones that are not reproducible.
"""

import csv
import io
import json
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, NullLocator, PercentFormatter
from matplotlib.transforms import ScaledTranslation
from rich.table import Table
from scipy.stats import rankdata

from sionna_radar.accuracy.compare import LE90_MEANING, DemError
from sionna_radar.execution.workers import versions
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import read_text, shown
from sionna_radar.foundation.numerics import is_number
from sionna_radar.foundation.raster import Raster
from sionna_radar.report.colours import BLUE, GREEN, ORANGE, PURPLE, RED, SKY
from sionna_radar.report.drawing import ReportFigure, readable
from sionna_radar.report.files.contents import RUNS_FILES, Keep, RunsFile, csv_text
from sionna_radar.report.files.points_table import check_parquet
from sionna_radar.report.study_document import Column, StudyDocument
from sionna_radar.report.survey.summary import better_map
from sionna_radar.report.terminal import number, table_of, with_spread
from sionna_radar.scenario import parse_scenario
from sionna_radar.studies.sweep import MARKER
from sionna_radar.studies.sweep.common_cells import unequal_areas
from sionna_radar.studies.sweep.ranking import COLUMNS, Ranking, ranked
from sionna_radar.studies.sweep.settings import Axis, label, short
from sionna_radar.studies.sweep.study import Case, Sweep
from sionna_radar.studies.sweep.trial import MAPS, OBSTACLE_STATISTICS, OWN_STATISTICS, STATISTICS, Trial

COLOURS = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY, "black")
SINGLE = "one trial each"
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
PANELS = {
    "rms_m": "RMS error of lit cells (m)",
    "off_wall_rms_m": "RMS error of lit cells\noff walls (m)",
    "nmad_m": "NMAD of lit cells (m)",
    "mean_m": "Mean error of lit cells (m)",
    "coverage": "Share of lit cells\nwith a height (%)",
    "coverage_of_swath": "Share of the planned swath\nwith a height (%)",
}
SHARES = ("coverage", "coverage_of_swath")
# Panels with an optional logarithmic scale, and the ratio of largest to smallest value from which it is used.
SIZES = ("rms_m", "off_wall_rms_m", "nmad_m")
LOGARITHMIC_FROM = 8.0
# Ratio of the top of a linear scale to the highest value, so that its dot is not clipped.
HEADROOM = 1.06
# Offset of the dots of the trials from their mean, in points, so that its bar does not hide them.
BESIDE_PT = 7.0
# Minimum number of settings for a rank correlation.
MIN_RANKED = 8
# Rows of small multiples, and the longest line of the name beside one, in characters.
MAX_MULTIPLES = 24
MAX_BESIDE = 18
# Longest name in half the width of the figure, in characters.
MAX_IN_HALF = 50
# Characters of labels that fit side by side under one panel.
MAX_LETTERS = 45


def figures_of(sweep: Sweep) -> dict[str, Callable[[Sweep], Figure]]:
    """Return one drawing per varied key, by name; none where only seeds differ."""
    if not sweep.axes:
        return {}
    main = abscissa(sweep.axes)
    others = [axis for axis in sweep.axes if axis != main and len(axis.values) > 1]
    against = {f"sweep_{re.sub('[^A-Za-z0-9]+', '_', axis.key)}": partial(errors, across=axis) for axis in others}
    return {"sweep": errors, **against}


def errors(sweep: Sweep, across: Axis | None = None) -> Figure:
    """Draw the errors of lit cells and the coverage against one varied key, a line per setting of the listed others.

    Values sampled or from a table are dots without a line, with Spearman's rank correlation beside them.
    """
    across = across or abscissa(sweep.axes)
    lines = _lines(sweep, across)
    trials = f"bars: standard deviation over {sweep.repeat} seeds; dots beside: trials" if sweep.repeat > 1 else SINGLE
    if len(lines) > len(COLOURS):
        return _small_multiples(sweep, across, lines, trials)
    figure = ReportFigure(figsize=(9.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True).ravel()
    for axes, statistic in zip(panels, _panels(sweep), strict=True):
        for index, (title, cases) in enumerate(lines):
            shift = (index - (len(lines) - 1) / 2) * min(0.12, 0.6 / len(lines))
            style = title, COLOURS[index], MARKERS[index], shift
            _draw_line(axes, across, cases, statistic, style, joined=_joined(sweep, across))
        axes.set_ylabel(PANELS[statistic])
        _finish_ordinates([axes], sweep, statistic)
        axes.set_title(_correlation(sweep, across, statistic), fontsize="small", loc="right")
    for axes in panels[2:]:
        _finish_abscissa(axes, across)
    figure.suptitle(f"{sweep.source}: elevation error\n{trials}", fontsize="medium", parse_math=False)
    if len(lines) > 1:
        handles, names = panels[0].get_legend_handles_labels()
        columns = 2 if max(map(len, names)) <= MAX_IN_HALF else 1
        texts = [fill(name, MAX_IN_HALF * 2 // columns) for name in names]
        figure.legend(handles, texts, loc="outside lower center", ncols=columns, frameon=False)
    return figure


def _small_multiples(sweep: Sweep, across: Axis, lines: list[tuple[str, list[Case]]], trials: str) -> Figure:
    """Draw each line in panels of its own, all others grey behind it; of many `MAX_MULTIPLES`, of least error."""
    least = [min((c.mean("rms_m") for c in cases if c.trials), default=np.inf) for _, cases in lines]
    shown = sorted(np.argsort(least, kind="stable")[:MAX_MULTIPLES])
    statistics, joined = _panels(sweep), _joined(sweep, across)
    figure = ReportFigure(figsize=(9.0, 1.2 + 1.3 * len(shown)), layout="constrained")
    panels = figure.subplots(len(shown), len(statistics), sharex=True, sharey="col")
    for column, statistic in zip(panels.T, statistics, strict=True):
        for place, axes in zip(shown, column, strict=True):
            title, cases = lines[place]
            for _, others in lines:
                points = [(_place(across, case.setting[across.key]), case.mean(statistic)) for case in others]
                axes.plot(*np.transpose(points), ls="-" if joined else "", marker=".", ms=2, lw=0.8, color="0.8")
            _draw_line(axes, across, cases, statistic, (title, BLUE, "o", 0.0), joined=joined)
        _finish_ordinates(list(column), sweep, statistic)
        column[0].set_title(f"{PANELS[statistic]}\n{_correlation(sweep, across, statistic)}".rstrip(), fontsize="small")
        _finish_abscissa(column[-1], across)
    for place, axes in zip(shown, panels[:, 0], strict=True):
        axes.set_ylabel(fill(lines[place][0], MAX_BESIDE), fontsize="small")
    head = f"{sweep.source}: elevation error, {len(shown)} of {len(lines)} settings (grey: all)"
    figure.suptitle(f"{head}\n{trials}", fontsize="medium", parse_math=False)
    return figure


def _panels(sweep: Sweep) -> list[str]:
    """Return the statistics of the four panels.

    If there are walls, the error off walls takes the place of the NMAD; where the planned swath is known, its coverage
    that of the lit cells.
    """
    walls, swath = (
        any(np.isfinite(case.mean(name)) for case in sweep.cases) for name in ("off_wall_rms_m", "coverage_of_swath")
    )
    left_out = "nmad_m" if walls else "off_wall_rms_m", "coverage" if swath else "coverage_of_swath"
    return [statistic for statistic in PANELS if statistic not in left_out]


def _finish_ordinates(column: Sequence[Axes], sweep: Sweep, statistic: str) -> None:
    top = max(axes.dataLim.y1 for axes in column)
    sizes = np.array([case.mean(statistic) for case in sweep.cases])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    for axes in column:
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
        if statistic == "mean_m":
            axes.axhline(0.0, color="black", lw=0.8)
        if statistic in SHARES:
            axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=""))
        if statistic in SIZES and len(sizes) and sizes.max() >= LOGARITHMIC_FROM * sizes.min():
            axes.set_yscale("log", nonpositive="mask")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter(NullFormatter())
        elif statistic in SIZES and len(sizes):
            axes.set_ylim(0.0, HEADROOM * top)


def abscissa(axes: tuple[Axis, ...]) -> Axis:
    """Return the axis of the abscissa: the numeric one with most values, otherwise the one with most values."""
    return max(axes, key=lambda axis: (_numeric(axis), len(axis.values)))


def _numeric(axis: Axis) -> bool:
    return len(axis.values) > 1 and all(map(is_number, axis.values))


def _lines(sweep: Sweep, across: Axis) -> list[tuple[str, list[Case]]]:
    """Return the cases of each setting of the other listed keys, with its name, in the order of the abscissa."""
    listed = [axis.key for axis in sweep.axes if axis.crossed and axis.key != across.key]
    lines: dict[str, tuple[str, list[Case]]] = {}
    for case in sweep.cases:
        setting = {key: case.setting[key] for key in listed}
        name = ", ".join(f"{readable(key)}: {short(value)}" for key, value in setting.items())
        if across.key in case.setting:
            lines.setdefault(repr(setting), (name, []))[1].append(case)
    lines = {key: line for key, line in lines.items() if any(case.trials for case in line[1])}
    if _numeric(across):
        return [(name, sorted(cases, key=lambda c: c.setting[across.key])) for name, cases in lines.values()]
    return list(lines.values())


def _joined(sweep: Sweep, across: Axis) -> bool:
    """Return True if the dots of a line differ only in their abscissa, a number."""
    return _numeric(across) and all(axis.crossed for axis in sweep.axes)


def _correlation(sweep: Sweep, across: Axis, statistic: str) -> str:
    """Return the rank correlation of a statistic with a key without listed values; "" if undefined."""
    cases = [case for case in sweep.cases if across.key in case.setting and np.isfinite(case.mean(statistic))]
    if across.crossed or not _numeric(across) or len(cases) < MIN_RANKED:
        return ""
    pairs = np.array([(case.setting[across.key], case.mean(statistic)) for case in cases])
    ranks = [rankdata(values) for values in pairs.T]
    if min(map(np.ptp, ranks)) == 0:
        return ""
    return f"rank correlation {np.corrcoef(ranks)[0, 1]:+.2f}"


def _draw_line(
    axes: Axes, across: Axis, cases: list[Case], statistic: str, style: tuple[str, str, str, float], *, joined: bool
) -> None:
    name, colour, marker, shift = style
    numeric = _numeric(across)
    x = np.array([_place(across, case.setting[across.key]) for case in cases], dtype=float)
    if not numeric:
        x = x + shift  # bars over the same word would overlap
    for place, case in zip(x, cases, strict=True):
        if len(case.trials) > 1:
            values = case.of_trials(statistic)
            beside = axes.transData + ScaledTranslation(BESIDE_PT / 72, 0.0, axes.figure.dpi_scale_trans)
            at = np.full(len(values), place)
            axes.plot(at, values, ls="", marker="o", ms=4, mew=0, color=colour, alpha=0.6, transform=beside)
    mean = [case.mean(statistic) for case in cases]
    spread = np.array([case.spread(statistic) for case in cases])
    bars = spread if np.isfinite(spread).any() else None
    line, size = ("-", 6) if joined else ("", 4)
    axes.errorbar(x, mean, bars, ls=line, lw=1.2, marker=marker, ms=size, capsize=4, color=colour, label=name)


def _place(across: Axis, value: Any) -> float:
    return float(value) if _numeric(across) else float(across.values.index(value))


def _finish_abscissa(axes: Axes, across: Axis) -> None:
    axes.set_xlabel(readable(across.key))
    values = list(across.values)
    if not _numeric(across):
        names = [short(value) for value in values]
        crowded = sum(len(name) + 2 for name in names) > MAX_LETTERS
        slanted = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"} if crowded else {}
        axes.set_xticks(range(len(values)), names, **slanted)
        axes.set_xlim(-0.5, len(values) - 0.5)
        return
    logarithmic = _even_in_logarithm(across)
    if logarithmic:
        axes.set_xscale("log")
        axes.xaxis.set_minor_locator(NullLocator())
    if len(values) <= 8 and _apart(sorted(map(float, values)), logarithmic):
        axes.xaxis.set_major_locator(FixedLocator(sorted(values)))
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    elif logarithmic:
        axes.xaxis.set_major_formatter("{x:g}")


def _even_in_logarithm(across: Axis) -> bool:
    """Return True if values span a wide range, more evenly on a logarithmic scale; decibels are logarithms already."""
    low, high = float(min(across.values)), float(max(across.values))
    if low <= 0 or high < LOGARITHMIC_FROM * low or across.key.endswith(("_db", "_dbm", "_dbsm")):
        return False
    middle = float(np.median(np.array(across.values, dtype=float)))
    return bool(abs(middle - np.sqrt(low * high)) < abs(middle - (low + high) / 2))


def _apart(values: list[float], logarithmic: bool) -> bool:
    """Return True if ticks at all values leave room for their labels."""
    place = np.log(values) if logarithmic else np.array(values, dtype=float)
    return len(values) == 1 or bool(np.diff(place).min() >= 0.08 * np.ptp(place))


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
                    path = _map_file(folder, case_number, trial.seed, name)
                    path.parent.mkdir(exist_ok=True)
                    trial.maps[name].to_geotiff(path)


def _map_file(folder: Path, case_number: int, seed: int, name: str) -> Path:
    return folder / "maps" / f"{case_number}_seed_{seed}_{name}.tif"


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
REMEDY = "give a folder that `sionna-radar sweep --shard` wrote"
UNKNOWN = dict.fromkeys(COSTS, float("nan"))


def read_sweep(folder: Path) -> Sweep:
    """Return the sweep in a folder; raises InputFileError for a missing or damaged one."""
    text = read_text(folder / DOCUMENT.marker, "sweep =", REMEDY)
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
        raise InputFileError(f"{shown(folder / DOCUMENT.marker)} is damaged ({error}); {REMEDY}") from error


def _costs(folder: Path) -> list[dict[str, float]]:
    """Return the costs of each survey from `runs.csv`, in order; empty without that table."""
    table = folder / RUNS_CSV
    rows = csv.DictReader(io.StringIO(read_text(table, "sweep =", REMEDY) if table.exists() else "", newline=""))
    return [{name: float(row[name] or "nan") for name in COSTS} for row in rows if row["run_seed"]]


def _case(document: dict[str, Any], costs: Iterator[dict[str, float]], folder: Path, case_number: int) -> Case:
    trials = []
    for run in document["runs"]:
        trial = Trial.of_document(run | next(costs, UNKNOWN))
        error = _map_file(folder, case_number, run["seed"], "error")
        trials.append(replace(trial, maps={"error": Raster.read(error)} if error.is_file() else {}))
    return Case(
        setting=document["setting"],
        scenario=parse_scenario(document["scenario"]) if document["scenario"] else None,
        trials=tuple(trials),
        reason=document["reason"] or "",
    )
