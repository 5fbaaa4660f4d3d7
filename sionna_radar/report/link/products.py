"""The folder of a link budget."""

import csv
import io
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.decibel import decibels
from sionna_radar.report.folder import without_nan, write_study
from sionna_radar.report.link.figures import draw_all
from sionna_radar.studies.link_result import SURE, TOLERANCE_DB, Link, LinkBudget, Simulated

MARKER = "link.json"
MEANING = (
    "snr_db is the mean power of the ground's strongest range cell over the noise in it, signal_to_clutter_db over "
    "what is in the air there. detection_probability is that of detecting the ground in this cell in one pulse "
    "against noise and clutter, false_alarm_probability that the cell passes the CFAR without the ground, "
    "passing_probability that it passes with all that is in it. Under `simulated` passed is the share of simulated "
    "pulses in which it does, and difference_db ground and clutter there over the closed form. reach_m is the farthest "
    "range up to which the cell passes with reach_probability and holds more of the ground than clutter; with "
    "reaches_the_end the sampled ranges end before it does."
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
    rows.writerow(["material", "incidence_deg", "rain_mm_per_h", "range_m", *budget.links[0].ground[0].numbers()])
    for link in budget.links:
        for range_m, ground in zip(link.range_m, link.ground, strict=True):
            own = [f"{value:.6g}" if np.isfinite(value) else "" for value in (range_m, *ground.numbers().values())]
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
        "reaches_the_end": link.reaches_the_end,
        "range_m": link.range_m.tolist(),
        **{name: _finite(np.array([one.numbers()[name] for one in link.ground])) for name in link.ground[0].numbers()},
        "simulated": [_simulated(one) for one in link.simulated],
    }


def _simulated(one: Simulated) -> dict[str, Any]:
    return {
        "range_m": one.range_m,
        **one.ground.numbers(),
        "difference_db": one.difference_db,
        "spread_db": one.spread_db,
        "compared": one.compared,
        "passed": one.passed,
        "echo_passed": one.echo_passed,
        "reason": one.reason or None,
    }


def _finite(values: Float[np.ndarray, " n"]) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
