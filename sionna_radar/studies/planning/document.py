"""Flight plans as tables, and the scenario that they are written to."""

import math

from sionna_radar.report.files.signed_file import SignedFile
from sionna_radar.report.terminal import console, say, table_of_values
from sionna_radar.studies.planning.study import FlightPlan, PlanCheck


def print_plan(plan: FlightPlan) -> None:
    """Print the planned flight."""
    values = {
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
    console().print(table_of_values(None, values))


def print_check(check: PlanCheck) -> None:
    """Print the achieved sampling of the area over its terrain, and a remedy if it is too coarse."""
    requested_m = check.plan.wanted.sampling_m
    values = {
        f"sampled at {requested_m:g} m or finer": f"{check.coverage:.2%} of the area",
        "sampling of 95 % of the area": f"{check.sampling_of(0.95):.2f} m or finer",
        "coarsest": f"{check.coarsest_m:.2f} m",
    }
    console().print(table_of_values("Beam axes over the terrain of the scenario", values))
    if check.coverage < 1:
        say(
            "part of the area is sampled too coarsely, because the terrain is not level; plan with a greater --slope "
            "or --overlap, a finer --sampling, or a base with platform.height = 'terrain_following'"
        )


PLAN_FILE = SignedFile(command="plan", before="# ")
