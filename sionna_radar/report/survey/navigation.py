"""The refined navigation of a survey: rows, document and table of poses."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.instrument import UNKNOWNS
from sionna_radar.mapping.navigation.refinement import RefinedNavigation
from sionna_radar.report.files.points_table import write_csv
from sionna_radar.survey.navigation import WayError, in_words
from sionna_radar.survey.result import Processed, Survey

MEANING = (
    "errors of the navigation, estimated from the echoes (processing.navigation = 'refined'): of each its standard "
    "deviations as stated and after the flight, RMS over the pulses, and whether the echoes tell it; way: RMS errors "
    "of the antenna's place and of its axes with the reported and the refined poses, and the share of pulses within "
    "the intervals of 68 and 95 %, where the truth is known; null for reported navigation"
)


def navigation_document(navigation: RefinedNavigation, way: WayError | None) -> dict[str, Any]:
    """Return the refined navigation as the summary holds it."""
    rows = zip(navigation.names, _rms(navigation.before), _rms(navigation.sigma), navigation.observable, strict=True)
    errors = {
        f"{in_words(name)} ({UNKNOWNS[name].unit})": {
            "stated": stated / UNKNOWNS[name].si,
            "sigma": sigma / UNKNOWNS[name].si,
            "observable": bool(observable),
        }
        for name, stated, sigma, observable in rows
    }
    return {
        "errors": errors,
        "reduced_chi2": navigation.reduced_chi2,
        "used": navigation.holds,
        "way": None if way is None else way.document(),
    }


def navigation_rows(navigation: RefinedNavigation | None, way: WayError | None) -> dict[str, str]:
    """Return the refined navigation in the table of a survey on the console."""
    if navigation is None or not navigation.holds:
        return {}
    if way is None:
        told = [in_words(n) for n, known in zip(navigation.names, navigation.observable, strict=True) if known]
        return {"navigation refined": f"the echoes tell {', '.join(told) or 'none of its errors'}"}
    (before, after), (pointing, refined) = way.place_m, way.pointing_deg
    return {
        "navigation refined": f"place {np.linalg.norm(before):.3g} to {np.linalg.norm(after):.3g} m RMS, "
        f"axes {pointing:.2g} to {refined:.2g} deg"
    }


def write_navigation(result: Survey | Processed, directory: Path) -> None:
    """Write the refined place of the antenna at each pulse, and the errors taken out with standard deviations."""
    navigation = result.navigation
    if navigation is None:
        return
    columns: dict[str, np.ndarray] = {"pulse": np.arange(len(navigation.time_s)), "time_s": navigation.time_s}
    for axis, values in zip(("east", "north", "up"), navigation.poses.pose.position_m.T, strict=True):
        columns[f"antenna_{axis}_m"] = values
    for name, value, sigma in zip(navigation.names, navigation.value.T, navigation.sigma.T, strict=True):
        unit = UNKNOWNS[name]
        key, suffix = in_words(name).replace(" ", "_"), {"m/s": "mps"}.get(unit.unit, unit.unit)
        columns[f"{key}_error_{suffix}"], columns[f"{key}_sigma_{suffix}"] = value / unit.si, sigma / unit.si
    form = {"pulse": "%.0f", "time_s": "%r"}
    path, count = directory / "navigation.csv", len(navigation.time_s)
    write_csv(path, count, lambda rows: {name: v[rows] for name, v in columns.items()}, form, "%.6f")


def _rms(values: Float[np.ndarray, "pulse error"]) -> Float[np.ndarray, " error"]:
    return np.sqrt(np.mean(values**2, axis=0))
