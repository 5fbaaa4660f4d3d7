"""Navigation error budget: files, tables, figure."""

import math
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from rich.table import Table

from sionna_radar.report.colours import BLUE, ORANGE, RED
from sionna_radar.report.drawing import ReportFigure
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.report.terminal import number, table_of
from sionna_radar.studies.budget.study import Budget, GradeResult, Limit

STYLES = {
    "constant": (BLUE, "o", "Constant"),
    "white": (ORANGE, "s", "White, standard deviation"),
    "markov": (RED, "D", "Gauss-Markov, standard deviation"),
}
# Vertical offsets by kind of error, so that equal limits do not overlap.
DODGE = {"constant": -0.2, "white": 0.0, "markov": 0.2}
QUANTITIES = {"m": "Metres", "m/s": "Metres per second", "deg": "Degrees", "s": "Seconds"}


def draw(budget: Budget) -> Figure:
    """Draw a panel of limits per unit, then the DEM RMS error by grade."""
    units = [unit for unit in QUANTITIES if any(limit.error.unit == unit for limit in budget.limits)]
    panels = [[limit for limit in budget.limits if limit.error.unit == unit] for unit in units]
    heights = [0.9 + 0.3 * len({limit.error.name for limit in panel}) for panel in panels]
    heights += [0.9 + 0.35 * (len(budget.grades) + 1)]
    figure = ReportFigure(figsize=(8.5, sum(heights) + 0.8), layout="constrained")
    axes = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    for panel, unit, place in zip(panels, units, axes[:-1], strict=True):
        _draw_limits(place, panel, unit)
    _draw_grades(axes[-1], budget)
    figure.suptitle(f"Navigation error that alone raises the DEM's RMS error by {budget.growth:.0%}")
    named: dict[str, Any] = {}
    for place in axes[:-1]:
        handles, labels = place.get_legend_handles_labels()
        named |= dict(zip(labels, handles, strict=True))
    figure.legend(named.values(), named, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _draw_limits(axes: Axes, limits: list[Limit], unit: str) -> None:
    names = list(dict.fromkeys(limit.error.name for limit in limits))
    for limit in limits:
        colour, marker, label = STYLES[limit.error.kind]
        row = names.index(limit.error.name) + DODGE[limit.error.kind]
        reached = math.isfinite(limit.size)
        size = limit.size if reached else limit.error.largest
        style = {"marker": marker, "mfc": colour, "label": label}
        if not reached:
            style = {"marker": ">", "mfc": "white", "label": "Limit beyond the largest tested"}
        axes.plot(size, row, ls="", ms=8, mec=colour, **style)
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    axes.set_xlim(10 ** math.floor(math.log10(low)), 10 ** math.ceil(math.log10(high)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.4, -0.6))
    axes.set_xlabel(f"{QUANTITIES[unit]} ({unit})" if unit != "deg" else "Degrees")
    axes.grid(alpha=0.3, which="both")


def _draw_grades(axes: Axes, budget: Budget) -> None:
    names = ["exact pose", *(grade.name for grade in budget.grades)]
    sizes = [budget.rms_m, *(grade.rms_m for grade in budget.grades)]
    axes.barh(range(len(names)), sizes, color=["0.6", *[BLUE] * len(budget.grades)], height=0.6)
    for row, size in enumerate(sizes):
        if math.isfinite(size):
            text = axes.annotate(f"{size:.3f} m", (size, row), xytext=(8, 0), textcoords="offset points", va="center")
            text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 1.0})
    axes.axvline(budget.rms_m * (1 + budget.growth), color="black", lw=1, ls="--", zorder=0.5)
    axes.set(yticks=range(len(names)), yticklabels=names)
    axes.set_xlabel("RMS error of lit cells (m); dashed: allowed")
    axes.invert_yaxis()
    axes.margins(x=0.15)
    axes.spines[["top", "right"]].set_visible(False)


def budget_numbers(budget: Budget) -> dict[str, Any]:
    """Return the numbers; a limit above the tested sizes is infinite."""
    return {
        "scenario": budget.scenario,
        "growth": budget.growth,
        "repeat": budget.repeat,
        "rms_m": budget.rms_m,
        "limits": [
            {
                "error": limit.error.name,
                "kind": limit.error.kind,
                "unit": limit.error.unit,
                "key": f"platform.navigation.{limit.error.key}",
                "axes": limit.error.axes,
                "limit": limit.size,
                "largest_tried": limit.error.largest,
            }
            for limit in budget.limits
        ],
        "grades": budget.grades,
    }


def limits_table(budget: Budget) -> Table:
    """Return the limits: a row per error; columns constant, white, Gauss-Markov."""
    title = (
        f"RMS error of lit cells {number(budget.rms_m, '.3f', ' m')} with the exact pose; "
        f"limits: the navigation error that alone raises it by {budget.growth:.0%}"
    )
    rows: dict[str, dict[str, str]] = {}
    for limit in budget.limits:
        error, size = limit.error, limit.size
        text = f"{size:.3g} {error.unit}" if math.isfinite(size) else f"> {error.largest:g} {error.unit}"
        rows.setdefault(error.name, dict.fromkeys(KINDS, ""))[error.kind] = text
    texts = ([name, *row.values()] for name, row in rows.items())
    return table_of(title, ["error", *KINDS.values()], texts, left=["error"])


KINDS = {"constant": "constant", "white": "white", "markov": "Gauss-Markov"}
GRADES = Columns[GradeResult](
    [
        Column(key="name", heading="grade"),
        Column(key="rms_m", heading="RMS", form=".3f", unit=" m"),
        Column(key="growth", heading="growth", form="+.0%"),
        Column(key="coverage", heading="coverage of lit cells", form=".1%"),
    ]
)


REFINED = Column[GradeResult](key="refined_rms_m", heading="refined by the echoes", form=".3f", unit=" m")


def tables(budget: Budget) -> list[Table]:
    """Return the limits, and the DEM error with each grade of GPS/IMU."""
    title = "All errors of a grade of GPS/IMU together"
    refines = any(grade.refined_rms_m is not None for grade in budget.grades)
    columns = Columns([*GRADES.columns, REFINED]) if refines else GRADES
    return [limits_table(budget), *([columns.table(title, budget.grades)] if budget.grades else [])]


DOCUMENT = StudyDocument[Budget](
    marker="budget.json",
    suffix="_budget",
    numbers=budget_numbers,
    tables=tables,
    lines=lambda budget: [f"{grade.name}: {grade.source}" for grade in budget.grades],
    figures=lambda _: {"budget": draw},
    notebook=["budget"],
)
