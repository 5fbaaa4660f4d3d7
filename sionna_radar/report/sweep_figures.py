"""The figure of a sweep: the error of the DEM against what was varied, with the spread over the runs."""

from itertools import cycle
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, PercentFormatter

from sionna_radar.report.colours import BLUE, GREEN, ORANGE, PURPLE, RED, SKY
from sionna_radar.report.figure_files import save_figures
from sionna_radar.sweep import Axis, Case, Sweep, label

COLOURS = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY, "black")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
PANELS = {
    "rms_m": "RMS error (m)",
    "mean_m": "Mean error (m)",
    "nmad_m": "NMAD (m)",
    "coverage": "Coverage",
}
MAX_LEGEND = 14


def draw_all(sweep: Sweep, directory: Path) -> list[Path]:
    """Draw the figure into a directory as PNG, and return the file."""
    return save_figures(sweep, {"sweep": errors}, directory)


def errors(sweep: Sweep) -> Figure:
    """Draw RMS, mean, NMAD and coverage against one varied key, a line for each setting of the others."""
    across = abscissa(sweep.axes)
    lines = _lines(sweep, across)
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True).ravel()
    for axes, (statistic, name) in zip(panels, PANELS.items(), strict=True):
        for index, ((title, cases), (colour, marker)) in enumerate(
            zip(lines.items(), zip(cycle(COLOURS), cycle(MARKERS), strict=False), strict=False)
        ):
            shift = (index - (len(lines) - 1) / 2) * min(0.12, 0.6 / len(lines))
            _draw_line(axes, across, cases, statistic, (title, colour, marker, shift))
        axes.set_ylabel(name)
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    panels[1].axhline(0.0, color="black", lw=0.8)
    panels[3].yaxis.set_major_formatter(PercentFormatter(1.0))
    for axes in panels[2:]:
        _finish_abscissa(axes, across)
    runs = f"bars: standard deviation over {sweep.repeat} seeds; dots: runs" if sweep.repeat > 1 else "one run each"
    figure.suptitle(f"{sweep.source}: elevation error ({runs})", fontsize="medium")
    if 1 < len(lines) <= MAX_LEGEND:
        handles = panels[0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=2, frameon=False)
    return figure


def abscissa(axes: tuple[Axis, ...]) -> Axis:
    """Return the axis to draw against: the numeric one with most values, or else the one with most values."""
    return max(axes, key=lambda axis: (_numeric(axis), len(axis.values)))


def _numeric(axis: Axis) -> bool:
    return len(axis.values) > 1 and all(isinstance(v, Real) and not isinstance(v, bool) for v in axis.values)


def _lines(sweep: Sweep, across: Axis) -> dict[str, list[Case]]:
    """Return the cases of each setting of the other keys, in the order of the abscissa."""
    lines: dict[str, list[Case]] = {}
    for case in sweep.cases:
        others = {key: value for key, value in case.setting.items() if key != across.key}
        lines.setdefault(label(others), []).append(case)
    if _numeric(across):
        return {name: sorted(cases, key=lambda c: c.setting[across.key]) for name, cases in lines.items()}
    return lines


def _draw_line(axes: Axes, across: Axis, cases: list[Case], statistic: str, style: tuple[str, str, str, float]) -> None:
    name, colour, marker, shift = style
    numeric = _numeric(across)
    x = np.array([_place(across, case.setting[across.key]) for case in cases], dtype=float)
    if not numeric:
        x = x + shift  # bars over one word would hide each other
    for place, case in zip(x, cases, strict=True):
        if len(case.runs) > 1:
            runs = case.of_runs(statistic)
            axes.plot(np.full(len(runs), place), runs, ls="", marker="o", ms=3, mew=0, color=colour, alpha=0.35)
    mean = [case.mean(statistic) for case in cases]
    spread = [np.nan_to_num(case.spread(statistic)) for case in cases]
    line = "-" if numeric else ""
    axes.errorbar(x, mean, spread, ls=line, lw=1.2, marker=marker, ms=6, capsize=4, color=colour, label=name)


def _place(across: Axis, value: Any) -> float:
    return float(value) if _numeric(across) else float(across.values.index(value))


def _finish_abscissa(axes: Axes, across: Axis) -> None:
    axes.set_xlabel(across.key)
    values = list(across.values)
    if not _numeric(across):
        axes.set_xticks(range(len(values)), [str(value) for value in values])
        axes.set_xlim(-0.5, len(values) - 0.5)
        return
    if min(values) > 0 and max(values) >= 8 * min(values):
        axes.set_xscale("log")
        axes.xaxis.set_minor_locator(NullLocator())
    if len(values) <= 8:
        axes.xaxis.set_major_locator(FixedLocator(sorted(values)))
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
