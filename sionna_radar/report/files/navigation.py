"""The refined navigation of a survey as CSV."""

from pathlib import Path

import numpy as np

from sionna_radar.flight.instrument import UNKNOWNS
from sionna_radar.report.files.points_table import write_csv
from sionna_radar.survey.navigation import in_words
from sionna_radar.survey.result import Processed, Survey


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
