"""The folder of a link budget."""

import csv
import io
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.decibel import decibels, to_db
from sionna_radar.report.folder import without_nan, write_study
from sionna_radar.report.link.figures import draw_all
from sionna_radar.studies.link_result import SURE, TOLERANCE_DB, Link, LinkBudget, Simulated

MARKER = "link.json"
COLUMNS = ("material", "incidence_deg", "rain_mm_per_h", "range_m", "snr_db", "clutter_db", "detection_probability")
MEANING = (
    "snr_db is the mean power of the ground's strongest range cell over the noise in a cell, clutter_db that of what "
    "is in the air there; detection_probability is that of this one cell in one pulse, clutter included. Under "
    "`simulated` the same, with clutter, from pulses that were traced, synthesised and detected. reach_m is the "
    "farthest range up to which the cell is detected with reach_probability and holds more of the ground than clutter."
)


def write_link(budget: LinkBudget, directory: Path) -> list[Path]:
    """Write `link.json`, `link.csv` and the figures into a directory, all or nothing, and return the files.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written; see `write_folder`.

    """
    tables = {"link.csv": link_csv(budget)}
    return write_study(directory, MARKER, link_summary(budget), partial(draw_all, budget), tables)


def link_summary(budget: LinkBudget) -> dict[str, Any]:
    """Return the numbers in strict JSON form; a number that does not exist is None."""
    document: dict[str, Any] = {
        "agrees": budget.agrees,
        "largest_difference_db": budget.largest_difference_db,
        "tolerance_db": TOLERANCE_DB,
        "dynamic_range_db": budget.dynamic_range_db,
        "reach_probability": SURE,
        "noise_w": budget.noise_w,
        "transmit_power_w": budget.transmit_power_w,
        "floors": _floors(budget),
        "meaning": MEANING,
        "links": [_link(link) for link in budget.links],
        "scenario": budget.scenario.model_dump(mode="json"),
    }
    return without_nan(document)


def link_csv(budget: LinkBudget) -> str:
    """Return the closed form as a table, a row for each range."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    for link in budget.links:
        columns = link.range_m, decibels(link.echo), decibels(link.clutter), link.detection
        for row in zip(*columns, strict=True):
            own = [f"{value:.6g}" if np.isfinite(value) else "" for value in row]
            rows.writerow([link.material, f"{link.incidence_deg:g}", f"{link.rain_mm_per_h:g}", *own])
    return text.getvalue()


def _floors(budget: LinkBudget) -> dict[str, Any]:
    found = budget.floors
    spectra = {"ground": found.ground, "clutter": found.clutter, **found.terms, "simulated": found.found}
    return {
        "ground_m": found.echo_m,
        "unit": "dBW" if budget.physical else "dB over the transmitted power",
        "highest": [{"floor": name, "from_m": start, "to_m": end} for name, start, end in found.rulers()],
        "range_m": found.range_m.tolist(),
        "power_db": {name: _finite(decibels(power)) for name, power in spectra.items()},
    }


def _link(link: Link) -> dict[str, Any]:
    return {
        "material": link.material,
        "incidence_deg": link.incidence_deg,
        "rain_mm_per_h": link.rain_mm_per_h,
        "reach_m": link.reach_m,
        "range_m": link.range_m.tolist(),
        "snr_db": _finite(decibels(link.echo)),
        "clutter_db": _finite(decibels(link.clutter)),
        "detection_probability": link.detection.tolist(),
        "simulated": [_simulated(one) for one in link.simulated],
    }


def _simulated(one: Simulated) -> dict[str, Any]:
    return {
        "range_m": one.range_m,
        "closed_form_db": to_db(one.expected),
        "difference_db": one.difference_db,
        "spread_db": one.spread_db,
        "compared": one.compared,
        "detection_probability": one.detection,
        "detected": one.detected,
        "echo_detected": one.echo_detected,
        "reason": one.reason or None,
    }


def _finite(values: Float[np.ndarray, " n"]) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
