"""The errors of a page: their table beside the reference paper's, their distribution, and where they are."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.accuracy.classes import ErrorClass
from sionna_radar.accuracy.compare import DemError
from sionna_radar.accuracy.uncertainty import INTERVALS_PERCENT, Calibration
from sionna_radar.report.page import markup
from sionna_radar.report.survey.reference_paper import reference_for
from sionna_radar.report.terminal import number
from sionna_radar.survey.result import Survey

BINS = 81
# A histogram that extends this many NMADs to each side has a logarithmic scale.
HEAVY_TAILS = 10
ERRORS = {
    "RMS": ("rms_m", ".3f"),
    "Mean": ("mean_m", "+.3f"),
    "Std. dev.": ("std_m", ".3f"),
    "NMAD": ("nmad_m", ".3f"),
    "LE68": ("le68_m", ".3f"),
    "LE90": ("le90_m", ".3f"),
    "LE95": ("le95_m", ".3f"),
    "Least": ("min_m", "+.2f"),
    "Greatest": ("max_m", "+.2f"),
}


def errors_section(survey: Survey) -> str:
    """Return the section of a page on the errors of a survey."""
    named = {
        "lit_error": ("Lit cells", survey.lit_error),
        "off_wall_error": ("Lit cells off walls", survey.off_wall_error),
        "dem_error": ("All filled cells", survey.dem_error),
    }
    rows = [_error_row(key, name, error) for key, (name, error) in named.items() if error is not None]
    paper = reference_for(survey.prepared)
    rows += [
        [one.name, *(number(getattr(one, key, np.nan), form) for key, form in ERRORS.values()), "-", "-"]
        for one in paper.rows
    ]
    note = (
        "Lit cells are those that the main beam reached; coverage is the share of them that the DEM fills. LE90 is the "
        f"90th percentile of |error|, not the width |P95 - P5|. {paper.conditions}"
    )
    table = markup.table(["DEM minus truth (m)", *ERRORS, "Cells", "Coverage"], rows, note)
    charts = f'<div class="grid small">{markup.plot("histogram", "chart")}{markup.plot("within", "chart")}</div>'
    return markup.section("errors", "Errors of the elevation model", table, charts, _where(survey), _stated(survey))


def _stated(survey: Survey) -> str:
    """Return how the errors compare with the uncertainty that the map states for each cell."""
    check = survey.dem_uncertainty
    if check is None:
        return ""
    rows = [["all", *_calibration_row(check.cells)]]
    for title, classes in (
        ("slope of the truth, deg", check.by_slope),
        ("distance from the nearest echo, m", check.by_echo_distance),
    ):
        rows += [[f"{title}: {one.low:g} to {one.high:g}", *_calibration_row(one.calibration)] for one in classes]
    note = (
        "Share of lit cells whose truth lies in the interval that the DEM states around their height (dem_sigma.tif); "
        "z is the error over the stated standard deviation."
    )
    heads = ["Lit cells", *(f"in {p} %" for p in INTERVALS_PERCENT), "NMAD of z", "RMS of z", "sigma, RMS (m)", "Cells"]
    return markup.table(heads, rows, note)


def _calibration_row(found: Calibration) -> list[str]:
    inside = [number(share, ".1%") for share in found.coverage.values()]
    spread = [number(found.nmad_z, ".2f"), number(found.rms_z, ".2f"), number(found.sigma_rms_m, ".3f")]
    return [*inside, *spread, f"{found.count:,}"]


def _where(survey: Survey) -> str:
    """Return where the errors are: by slope, incidence and distance from walls, and the test with checkpoints."""
    found = survey.breakdown
    tables = [
        _class_table("Slope of the truth (deg)", found.by_slope),
        _class_table("Incidence angle (deg)", found.by_incidence),
        _class_table("Distance from walls (m)", found.by_wall_distance or ()),
    ]
    statement = (
        markup.paragraph(f"Checkpoints: {found.checkpoints.statement}.", "note") if found.checkpoints.statement else ""
    )
    return f'<div class="tables">{"".join(tables)}</div>{statement}'


def _class_table(name: str, classes: Sequence[ErrorClass]) -> str:
    if not classes:
        return ""
    rows = [
        [
            f"{one.low:g} to {one.high:g}" if np.isfinite(one.high) else f"over {one.low:g}",
            number(one.rms_m, ".3f"),
            number(one.mean_m, "+.3f"),
            f"{one.count:,}",
        ]
        for one in classes
    ]
    return markup.table([name, "RMS (m)", "Mean (m)", "Cells"], rows)


def _error_row(key: str, name: str, error: DemError) -> list[markup.Cell | str]:
    values = asdict(error)
    cells: list[markup.Cell | str] = [name]
    for field, form in (*ERRORS.values(), ("count", ",.0f"), ("coverage", ".1%")):
        value = float(values[field])
        exact = value if value == value else None
        cells.append(markup.Cell(text=number(value, form), key=f"{key}.{field}", value=exact))
    return cells


def histogram_of(survey: Survey) -> dict[str, Any]:
    """Return the shares of lit cells by their error."""
    values = survey.error.within(survey.lit).height_m
    values = values[np.isfinite(values)]
    limit = 1.3 * limit_of(values)
    edges = np.linspace(-limit, limit, BINS + 1)
    share = 100 * np.histogram(values, edges)[0] / max(len(values), 1)
    percent = np.arange(0, 100)
    below = np.percentile(np.abs(values), percent).tolist() if len(values) else []
    lit = survey.lit_error
    marks = [(68.27, lit.le68_m), (90.0, lit.le90_m), (95.0, lit.le95_m)] if len(values) else []
    series = {"name": "lit cells", "share": share.tolist(), "below": below, "marks": marks}
    heavy = limit > HEAVY_TAILS * survey.lit_error.nmad_m > 0
    return {"edges": edges.tolist(), "percent": percent.tolist(), "series": [series], "heavy": bool(heavy)}


def limit_of(values: Float[np.ndarray, "..."]) -> float:
    """Return the error that 99 % of the cells stay within."""
    known = np.abs(values[np.isfinite(values)])
    return max(float(np.percentile(known, 99)), 1e-3) if len(known) else 1.0
