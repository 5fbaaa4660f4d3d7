"""Command `design`: the search for a radar and a flight."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sionna_radar.cli.session import SCENARIO, TEAM, Listed, Session, command, complete_key, parse_pair

if TYPE_CHECKING:
    from sionna_radar.cli.session import OpenCheckpoints
    from sionna_radar.studies.design.plan import RadarDesign


@command(*SCENARIO, *TEAM)
def design(
    session: Session,
    free: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=LOW:HIGH[:log]|V1,V2,...",
            help="Free parameter: range or values of a dotted key (repeat), e.g. dem.method=linear,smooth.",
            autocompletion=complete_key,
        ),
    ] = None,
    minimise: Annotated[
        list[str] | None, typer.Option(metavar="EXPR", help="What shall be least; twice for a Pareto front.")
    ] = None,
    maximise: Annotated[list[str] | None, typer.Option(metavar="EXPR", help="What shall be greatest.")] = None,
    require: Annotated[
        list[str] | None, typer.Option(metavar="CONDITION", help="What must hold, e.g. 'rms_m < 0.10' (repeat).")
    ] = None,
    worst_of: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SCENARIO|KEY=VALUE[;...]",
            help="Fly each setting there, too, and take the worst of all (repeat), e.g. weather.rain_rate_mm_per_h=10.",
        ),
    ] = None,
    costs: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Costs by component, TOML or CSV, as quantities, e.g. mass_kg.")
    ] = None,
    area: Annotated[
        str | None, typer.Option(metavar="EASTxNORTH", help="Area of flying_time_s and lines, m; default the flight's.")
    ] = None,
    overlap: Annotated[float, typer.Option(help="Overlap of neighbouring swaths over it, as a share.")] = 0.2,
    surveys: Annotated[int, typer.Option(metavar="N", help="Number of surveys in all.")] = 60,
    repeat: Annotated[int, typer.Option(min=2, metavar="N", help="Seeds with which the optimum is checked.")] = 5,
    confidence: Annotated[float, typer.Option(help="Probability with which each requirement must hold.")] = 0.9,
) -> None:
    """Find the radar and flight that meet requirements at the least cost, and how sure that is; exit code 1 if none.

    EXPR and CONDITION are arithmetic over keys of the scenario, costs, results of a survey (rms_m, le90_m, nmad_m,
    std_m, mean_m, min_m, max_m, coverage, which is the share of lit cells with a height, mapped_m2, mapped_swath_m,
    coverage_of_swath, which is that share of the planned swath, off_wall_rms_m, all_cells_rms_m, stated_sigma_m;
    where there are wires, poles or fences: pd_wire, pd_obstacle, warning_s, false_alarms_per_km2,
    false_alarms_per_minute) and quantities in closed form: aperture_m, swath_m, area_per_hour_km2, lines,
    flying_time_s, line_gap_m, dwell_s, pulses_per_s, samples_per_s, data_rate_mbps, transmit_power_w. If
    objectives and requirements name results of the map, but neither mapped_m2, mapped_swath_m nor coverage_of_swath,
    the latter must reach 95 % of the largest seen.
    """
    from sionna_radar.studies.design.document import DOCUMENT
    from sionna_radar.studies.design.plan import plan_design
    from sionna_radar.studies.design.study import run_design
    from sionna_radar.studies.sweep.costs import read_costs
    from sionna_radar.studies.sweep.quantities import Area

    size = None if area is None else parse_pair("--area", area, "x", "EASTxNORTH, e.g. 200x150")

    def fly(keep: "OpenCheckpoints") -> "RadarDesign":
        """Plan the design, and search for the best one."""
        plan = plan_design(
            session.scenario,
            free or [],
            minimise=minimise or [],
            maximise=maximise or [],
            require=require or [],
            overrides=session.overrides,
            worst_of=worst_of or [],
            costs=None if costs is None else read_costs(costs),
            area=None if size is None else Area(size_m=size, overlap=overlap),
            surveys=surveys,
            repeat=repeat,
            confidence=confidence,
        )
        with session.execution(keep, plan.identity()) as execution:
            return run_design(plan, execution=execution)

    session.produce(fly, DOCUMENT, exit_code=lambda result: 0 if result.holds else 1)


COMMANDS = (Listed("Study", "design", design),)
