"""A flight plan on the terminal."""

import math

from rich.console import Console
from rich.table import Table

from sionna_radar.errors import Problem, ScenarioError
from sionna_radar.planning import Plan


def parse_area(text: str) -> tuple[float, float]:
    """Return the extent of an area written as EASTxNORTH.

    Raises
    ------
    ScenarioError
        The text is no such extent.

    """
    try:
        east, north = (float(part) for part in text.lower().split("x"))
    except ValueError as error:
        raise ScenarioError([Problem("--area", f"{text!r} is not EASTxNORTH; give e.g. 200x150")], "plan") from error
    return east, north


def print_plan(plan: Plan) -> None:
    """Print what is to be flown."""
    table = Table(show_header=False)
    rows = {
        "altitude": f"{plan.altitude_m:.1f} m",
        "speed": f"{plan.speed_mps:.2f} m/s",
        "incidence, scan angles": (
            f"{math.degrees(plan.incidence_rad):.1f} deg, +-{math.degrees(plan.half_swath_rad):.1f} deg"
        ),
        "rotation": f"{plan.rotation_rpm:.0f} rpm",
        "chirps": f"{plan.chirp_rate_hz:.0f} per second, {plan.samples_per_chirp} samples each",
        "lines": f"{plan.lines}, {plan.line_spacing_m:.1f} m apart, swath {plan.swath_m:.1f} m",
        "flight": f"{plan.flight_s:.0f} s",
    }
    for name, value in rows.items():
        table.add_row(name, value)
    Console(highlight=False).print(table)
