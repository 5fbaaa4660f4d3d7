"""The folder of a navigation budget."""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from sionna_radar.report.budget.figures import draw_all
from sionna_radar.report.folder import without_nan, write_study
from sionna_radar.studies.budget import Budget

MARKER = "budget.json"


def write_budget(budget: Budget, directory: Path) -> list[Path]:
    """Write `budget.json` and the figure into a directory, all or nothing, and return the files.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written; see `write_folder`.

    """
    return write_study(directory, MARKER, budget_summary(budget), partial(draw_all, budget))


def budget_summary(budget: Budget) -> dict[str, Any]:
    """Return the numbers in strict JSON form; a limit that was not reached is None."""
    return {
        "scenario": budget.scenario.model_dump(mode="json"),
        "growth": budget.growth,
        "repeat": budget.repeat,
        "rms_m": without_nan(budget.rms_m),
        "limits": [
            {
                "error": limit.error.name,
                "kind": limit.error.kind,
                "unit": limit.error.unit,
                "key": f"platform.navigation.{limit.error.key}",
                "axes": limit.error.axes,
                "limit": without_nan(limit.size),
                "largest_tried": limit.error.largest,
            }
            for limit in budget.limits
        ],
        "grades": [without_nan(asdict(grade)) for grade in budget.grades],
    }
