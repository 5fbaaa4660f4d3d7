"""The figures of a sweep: the DEM error against each varied parameter, with the spread over the trials."""

import re
from collections.abc import Callable, Sequence
from functools import partial
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, NullLocator, PercentFormatter
from matplotlib.transforms import ScaledTranslation
from scipy.stats import rankdata

from sionna_radar.foundation.numerics import is_number
from sionna_radar.report.colours import BLUE, GREEN, ORANGE, PURPLE, RED, SKY
from sionna_radar.report.drawing import ReportFigure, readable
from sionna_radar.studies.sweep.settings import Axis, short
from sionna_radar.studies.sweep.study import Case, Sweep

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
