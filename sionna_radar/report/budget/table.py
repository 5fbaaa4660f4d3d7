"""The table of a navigation budget, for the terminal."""

import math

from rich.table import Table

from sionna_radar.report.terminal import console, number
from sionna_radar.studies.budget import Budget, Limit

KINDS = {"constant": "constant", "white": "white", "markov": "Gauss-Markov"}


def print_budget(budget: Budget) -> None:
    """Print the limits of all errors, and the DEM error with grades of GPS/IMU."""
    out = console()
    out.print(limits_table(budget))
    if not budget.grades:
        return
    out.print(grades_table(budget))
    for grade in budget.grades:
        out.print(f"{grade.name}: {grade.source}", soft_wrap=True)


def limits_table(budget: Budget) -> Table:
    """Return the limits of all errors, one row per error and one column per kind."""
    title = (
        f"RMS error of all DEM cells {number(budget.rms_m, '.3f', ' m')} with the exact pose; "
        f"limits: the navigation error that alone raises it by {budget.growth:.0%}"
    )
    limits = Table(title=title, title_justify="left")
    limits.add_column("error")
    for name in KINDS.values():
        limits.add_column(name, justify="right")
    for name in dict.fromkeys(limit.error.name for limit in budget.limits):
        found = {limit.error.kind: _limit_text(limit) for limit in budget.limits if limit.error.name == name}
        limits.add_row(name, *(found.get(kind, "") for kind in ("constant", "white", "markov")))
    return limits


def grades_table(budget: Budget) -> Table:
    """Return the DEM error with grades of GPS/IMU, one row per grade."""
    grades = Table(title="All errors of a grade of GPS/IMU together", title_justify="left")
    for name in ("grade", "RMS", "growth", "coverage"):
        grades.add_column(name, justify="left" if name == "grade" else "right")
    for grade in budget.grades:
        cells = number(grade.rms_m, ".3f", " m"), number(grade.growth, "+.0%"), number(grade.coverage, ".1%")
        grades.add_row(grade.name, *cells)
    return grades


def _limit_text(limit: Limit) -> str:
    unit = limit.error.unit
    return f"{limit.size:.3g} {unit}" if math.isfinite(limit.size) else f"> {limit.error.largest:g} {unit}"
