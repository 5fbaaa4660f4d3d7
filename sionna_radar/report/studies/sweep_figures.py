"""The figure of a sweep: DEM error against the varied parameters, with the spread over the trials."""

import re
from functools import partial
from numbers import Real
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, NullLocator, PercentFormatter
from matplotlib.transforms import ScaledTranslation
from scipy.stats import rankdata

from sionna_radar.report.drawing import BLUE, GREEN, ORANGE, PURPLE, RED, SKY, ReportFigure, readable, save_figures
from sionna_radar.studies.design import Axis
from sionna_radar.studies.sweep import Case, Sweep, short

COLOURS = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY, "black")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
PANELS = {
    "rms_m": "RMS error of lit cells (m)",
    "off_wall_rms_m": "RMS error of lit cells\noff walls (m)",
    "nmad_m": "NMAD of lit cells (m)",
    "mean_m": "Mean error of lit cells (m)",
    "coverage": "Coverage: share of lit\ncells with a height (%)",
}
# Panels with an optional logarithmic scale, and the ratio of largest to smallest value from which it is used.
SIZES = ("rms_m", "off_wall_rms_m", "nmad_m")
LOGARITHMIC_FROM = 8.0
# Ratio of the top of a linear scale to the highest value, so that its dot is not clipped.
HEADROOM = 1.06
# Offset of the dots of the trials from their mean, in points, so that its bar does not hide them.
BESIDE_PT = 7.0
# Minimum number of settings for a rank correlation.
MIN_RANKED = 8
MAX_LEGEND = 14
# Longest name in half the width of the figure, in characters.
MAX_IN_HALF = 50
# Characters of labels that fit side by side under one panel.
MAX_LETTERS = 45


def draw_all(sweep: Sweep, directory: Path) -> list[Path]:
    """Draw one figure per varied key into a directory as PNG, and return the files."""
    main = abscissa(sweep.axes)
    others = [axis for axis in sweep.axes if axis != main and len(axis.values) > 1]
    against = {f"sweep_{re.sub('[^A-Za-z0-9]+', '_', axis.key)}": partial(errors, across=axis) for axis in others}
    return save_figures(sweep, {"sweep": errors, **against}, directory)


def errors(sweep: Sweep, across: Axis | None = None) -> Figure:
    """Draw the errors of lit cells and the coverage against one varied key, a line per setting of the listed others.

    Values sampled or from a table are dots without a line, with Spearman's rank correlation beside them.
    """
    across = across or abscissa(sweep.axes)
    lines = _lines(sweep, across)
    statistics = _panels(sweep)
    figure = ReportFigure(figsize=(9.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True).ravel()
    for axes, statistic in zip(panels, statistics, strict=True):
        for index, (title, cases) in enumerate(lines):
            colour, marker = _style(index)
            shift = (index - (len(lines) - 1) / 2) * min(0.12, 0.6 / len(lines))
            _draw_line(axes, across, cases, statistic, (title, colour, marker, shift), joined=_joined(sweep, across))
        axes.set_ylabel(PANELS[statistic])
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
        _finish_ordinate(axes, sweep, statistic)
        axes.set_title(_correlation(sweep, across, statistic), fontsize="small", loc="right")
    for axes in panels[2:]:
        _finish_abscissa(axes, across)
    several = f"bars: standard deviation over {sweep.repeat} seeds; dots beside: trials"
    trials = several if sweep.repeat > 1 else "one trial each"
    figure.suptitle(f"{sweep.source}: elevation error\n{trials}", fontsize="medium", parse_math=False)
    if 1 < len(lines) <= MAX_LEGEND:
        handles, names = panels[0].get_legend_handles_labels()
        columns = 2 if max(map(len, names)) <= MAX_IN_HALF else 1
        texts = [fill(name, MAX_IN_HALF * 2 // columns) for name in names]
        figure.legend(handles, texts, loc="outside lower center", ncols=columns, frameon=False)
    return figure


def _style(index: int) -> tuple[str, str]:
    """Return a colour and a marker, unique for as many lines as there are pairs of them."""
    turn, count = divmod(index, len(COLOURS))
    return COLOURS[count], MARKERS[(count + turn) % len(MARKERS)]


def _panels(sweep: Sweep) -> list[str]:
    """Return the statistics of the four panels: if there are walls, the error off walls in place of the NMAD."""
    walls = any(np.isfinite(case.mean("off_wall_rms_m")) for case in sweep.cases)
    return [s for s in PANELS if s != ("nmad_m" if walls else "off_wall_rms_m")]


def _finish_ordinate(axes: Axes, sweep: Sweep, statistic: str) -> None:
    if statistic == "mean_m":
        axes.axhline(0.0, color="black", lw=0.8)
    if statistic == "coverage":
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=""))
    if statistic in SIZES:
        sizes = np.array([case.mean(statistic) for case in sweep.cases])
        sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
        if len(sizes) and sizes.max() >= LOGARITHMIC_FROM * sizes.min():
            axes.set_yscale("log", nonpositive="mask")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter(NullFormatter())
        elif len(sizes):
            axes.set_ylim(0.0, HEADROOM * axes.dataLim.y1)


def abscissa(axes: tuple[Axis, ...]) -> Axis:
    """Return the axis of the abscissa: the numeric one with most values, otherwise the one with most values."""
    return max(axes, key=lambda axis: (_numeric(axis), len(axis.values)))


def _numeric(axis: Axis) -> bool:
    return len(axis.values) > 1 and all(isinstance(v, Real) and not isinstance(v, bool) for v in axis.values)


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
    """Return whether the dots of a line differ only in their abscissa, a number."""
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
        axes.set_xticks(range(len(values)), [short(value) for value in values], **_slanted(values))
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
    """Return whether values span a wide range, more evenly on a logarithmic scale; decibels are logarithms already."""
    low, high = float(min(across.values)), float(max(across.values))
    if low <= 0 or high < LOGARITHMIC_FROM * low or across.key.endswith(("_db", "_dbm", "_dbsm")):
        return False
    middle = float(np.median(np.array(across.values, dtype=float)))
    return bool(abs(middle - np.sqrt(low * high)) < abs(middle - (low + high) / 2))


def _apart(values: list[float], logarithmic: bool) -> bool:
    """Return whether ticks at all values leave room for their labels."""
    place = np.log(values) if logarithmic else np.array(values, dtype=float)
    return len(values) == 1 or bool(np.diff(place).min() >= 0.08 * np.ptp(place))


def _slanted(values: list[Any]) -> dict[str, Any]:
    """Return the rotation that keeps long labels apart."""
    if sum(len(short(value)) + 2 for value in values) <= MAX_LETTERS:
        return {}
    return {"rotation": 30, "ha": "right", "rotation_mode": "anchor"}
