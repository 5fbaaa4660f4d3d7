"""Command `plan`: flights that cover an area."""

from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.cli.session import Listed, log_to_stderr, parse_pair, progress_shown
from sionna_radar.foundation.errors import OutputError, ScenarioError
from sionna_radar.foundation.input_file import shown


def plan(
    area: Annotated[
        str | None, typer.Option(metavar="EASTxNORTH", help="Extent of the area in metres, e.g. 200x150.")
    ] = None,
    sampling: Annotated[
        float | None, typer.Option(metavar="M", help="Greatest spacing between neighbouring echoes, m.")
    ] = None,
    base: Annotated[
        str | None, typer.Option(metavar="SCENARIO", help="Scenario to take terrain, radar and processing from.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Where the scenario goes.")] = Path(
        "plan.toml"
    ),
    position: Annotated[str, typer.Option(metavar="EAST,NORTH", help="Centre of the area, m.")] = "0,0",
    heading: Annotated[float, typer.Option(help="Clockwise rotation of the area about its centre, deg.")] = 0.0,
    altitude: Annotated[float | None, typer.Option(help="Height over the ground, m; default from the beam.")] = None,
    speed: Annotated[float, typer.Option(help="Fastest flight, m/s.")] = 10.0,
    incidence: Annotated[float, typer.Option(help="Greatest tilt of the beam from nadir, deg.")] = 45.0,
    half_swath: Annotated[float, typer.Option(help="Greatest scan angle, deg.")] = 50.0,
    overlap: Annotated[float, typer.Option(help="Overlap of neighbouring swaths, as a share.")] = 0.2,
    slope: Annotated[float, typer.Option(help="Steepest slope that must be free of shadow, deg.")] = 20.0,
    most_rpm: Annotated[float, typer.Option(help="Fastest rotation of the antenna, rpm.")] = 600.0,
    most_chirps: Annotated[float, typer.Option(help="Highest chirp rate, Hz.")] = 5000.0,
    calibration: Annotated[
        bool,
        typer.Option(
            "--calibration",
            help="Plan opposite and crossing lines at two heights over the middle of the base instead, for "
            "`calibrate`: two scenarios, FILE_low.toml and FILE_high.toml.",
        ),
    ] = False,
) -> None:
    """Plan a flight that covers an area, check it with the beam over the terrain, and write it as a scenario."""
    from sionna_radar.scenario import load_scenario, to_toml
    from sionna_radar.studies.planning.document import PLAN_FILE, print_check, print_plan
    from sionna_radar.studies.planning.study import Wanted, check_plan, planned_scenario
    from sionna_radar.studies.planning.study import plan as plan_flight

    log_to_stderr()
    if calibration:
        _plan_calibration(base, output, area, sampling)
        return
    if area is None or sampling is None:
        missing = "--area" if area is None else "--sampling"
        raise ScenarioError.of_option(missing, "is missing; add it, or --calibration")
    PLAN_FILE.check(output)
    wanted = Wanted(
        size_m=parse_pair("--area", area, "x", "EASTxNORTH, e.g. 200x150"),
        sampling_m=sampling,
        position_m=parse_pair("--position", position, ",", "EAST,NORTH, e.g. 120,-40"),
        heading_deg=heading,
        altitude_m=altitude,
        speed_mps=speed,
        incidence_deg=incidence,
        half_swath_deg=half_swath,
        overlap=overlap,
        greatest_slope_deg=slope,
        most_rotation_rpm=most_rpm,
        most_chirp_rate_hz=most_chirps,
    )
    taken = load_scenario(base) if base else None
    planned = plan_flight(wanted, taken)
    scenario = planned_scenario(planned, taken)
    with progress_shown(quiet=False):
        checked = check_plan(planned, scenario)
    PLAN_FILE.write(output, to_toml(scenario, defaults=False))
    print_plan(planned)
    print_check(checked)
    typer.echo(f"scenario in {shown(output)}")


def _plan_calibration(base: str | None, output: Path, area: str | None, sampling: float | None) -> None:
    from sionna_radar.scenario import load_scenario, to_toml
    from sionna_radar.studies.planning.document import PLAN_FILE
    from sionna_radar.studies.planning.study import calibration_flights

    if base is None or area is not None or sampling is not None:
        key, remedy = ("--base", "is needed") if base is None else ("--calibration", "takes no --area and --sampling")
        raise ScenarioError.of_option(key, f"{remedy}: ground, radar and height are the base's")
    if output.is_dir():
        raise OutputError(f"output = {shown(output)} is a folder; name a file, e.g. calibration.toml")
    files = [output.with_name(f"{output.stem}_{part}{output.suffix}") for part in ("low", "high")]
    for file in files:
        PLAN_FILE.check(file)
    with progress_shown(quiet=False):
        flights = calibration_flights(load_scenario(base))
    for file, flight in zip(files, flights, strict=True):
        PLAN_FILE.write(file, to_toml(flight, defaults=False))
    typer.echo(f"scenarios in {shown(files[0])} and {shown(files[1])}; fly both with `run --record signals`")


COMMANDS = (Listed("Begin", "plan", plan),)
