"""A planned flight as table and file."""

import math

from rich.table import Table

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.report.files.signed_file import SignedFile
from sionna_radar.report.terminal import console
from sionna_radar.studies.planning import FlightPlan, PlanCheck


def parse_pair(option: str, text: str, separator: str, form: str) -> tuple[float, float]:
    """Return the two numbers of a command-line option.

    Raises
    ------
    ScenarioError
        The text is not such a pair.

    """
    try:
        first, second = (float(word) for word in text.lower().split(separator))
    except ValueError as error:
        raise ScenarioError([Problem(option, f"{text!r} is not a pair of numbers; give {form}")], "plan") from error
    return first, second


def print_plan(plan: FlightPlan) -> None:
    """Print the planned flight."""
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
    console().print(table)


def print_check(check: PlanCheck) -> None:
    """Print the achieved sampling of the area over its terrain, and a remedy if it is too coarse."""
    requested_m = check.plan.wanted.sampling_m
    table = Table(title="Beam axes over the terrain of the scenario", title_justify="left", show_header=False)
    rows = {
        f"sampled at {requested_m:g} m or finer": f"{check.coverage:.2%} of the area",
        "sampling of 95 % of the area": f"{check.sampling_of(0.95):.2f} m or finer",
        "coarsest": f"{check.coarsest_m:.2f} m",
    }
    for name, value in rows.items():
        table.add_row(name, value)
    out = console()
    out.print(table)
    if check.coverage < 1:
        out.print(
            "part of the area is sampled too coarsely, because the terrain is not level; plan with a greater --slope "
            "or --overlap, a finer --sampling, or a base with platform.height = 'terrain_following'",
            soft_wrap=True,
        )


PLAN_FILE = SignedFile(command="plan", before="# ")
