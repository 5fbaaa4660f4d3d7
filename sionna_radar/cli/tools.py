"""The commands that plan, check and report; none of them writes a folder of results."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.cli.options import (
    BackendOption,
    NetworkOption,
    ScenarioArgument,
    SeedOption,
    SetFileOption,
    SetOption,
)
from sionna_radar.cli.session import Session, log_to_stderr, overrides_of, progress_of
from sionna_radar.foundation.input_file import shown


def add_to(app: typer.Typer) -> None:
    """Add the commands, in the order that `--help` lists them."""
    for command in (plan, validate, scenes, presets, doctor, bench, fit):
        app.command()(command)


def plan(
    area: Annotated[str, typer.Option(metavar="EASTxNORTH", help="Extent of the area in metres, e.g. 200x150.")],
    sampling: Annotated[float, typer.Option(metavar="M", help="Greatest spacing between neighbouring echoes, m.")],
    base: Annotated[
        str | None, typer.Option(metavar="SCENARIO", help="Scenario to take terrain, radar and processing from.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Where the scenario goes.")] = Path(
        "plan.toml"
    ),
    position: Annotated[str, typer.Option(metavar="EAST,NORTH", help="Centre of the area, m.")] = "0,0",
    heading: Annotated[float, typer.Option(help="Turns the area clockwise about its centre, deg.")] = 0.0,
    altitude: Annotated[float | None, typer.Option(help="Height over the ground, m; default from the beam.")] = None,
    speed: Annotated[float, typer.Option(help="Fastest flight, m/s.")] = 10.0,
    incidence: Annotated[float, typer.Option(help="Greatest tilt of the beam from nadir, deg.")] = 45.0,
    half_swath: Annotated[float, typer.Option(help="Greatest scan angle, deg.")] = 50.0,
    overlap: Annotated[float, typer.Option(help="Share of a swath that the next line covers again.")] = 0.2,
    slope: Annotated[float, typer.Option(help="Steepest slope that no shadow may fall on, deg.")] = 20.0,
    most_rpm: Annotated[float, typer.Option(help="Fastest turn of the antenna.")] = 600.0,
    most_chirps: Annotated[float, typer.Option(help="Highest chirp rate, Hz.")] = 5000.0,
) -> None:
    """Plan a flight that covers an area, fly its beam over the terrain to check it, and write it as a scenario."""
    from sionna_radar.report.plan.file import PLAN_FILE
    from sionna_radar.report.plan.table import parse_pair, print_check, print_plan
    from sionna_radar.scenario import load_scenario, to_toml
    from sionna_radar.studies.plan_check import check_plan
    from sionna_radar.studies.planning import Wanted, plan_flight, planned_scenario

    log_to_stderr()
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
    with progress_of(quiet=False) as progress:
        checked = check_plan(planned, scenario, progress)
    PLAN_FILE.write(output, to_toml(scenario))
    print_plan(planned)
    print_check(checked)
    typer.echo(f"scenario in {shown(output)}")


def validate(
    scenario: ScenarioArgument,
    set_: SetOption = None,
    set_file: SetFileOption = None,
    seed: SeedOption = None,
    network: NetworkOption = False,
) -> None:
    """Check a scenario, its terrain and its flight included, and print it with all values resolved."""
    from sionna_radar.scenario import to_toml
    from sionna_radar.scene.objects import placed_boxes
    from sionna_radar.survey.preparation import prepare

    session = Session.of(scenario, None, set_, set_file, seed, quiet=False, network=network)
    checked = session.load()
    with session.reach():
        prepared = prepare(checked)
    typer.echo(to_toml(checked), nl=False)
    for key, box in placed_boxes(prepared.scene.scene.surfaces).items():
        typer.echo(f"# {key} stands at {box}")


def scenes() -> None:
    """List the shipped scenarios."""
    import tomllib

    from sionna_radar.scenario import shipped_scenarios

    for name, path in shipped_scenarios().items():
        typer.echo(f"{name:16}{tomllib.loads(path.read_text(encoding='utf-8')).get('description', '')}")


def presets() -> None:
    """List the published radars that `radar.preset` names, with the sources of their figures and what was assumed."""
    from sionna_radar.scenario.presets import PRESETS

    for name, preset in PRESETS.items():
        typer.echo(f"{name}: {preset.summary}")
        for key, value in preset.radar.items():
            typer.echo(f"  {key} = {value}")
        for source in preset.sources:
            typer.echo(f"  source: {source}")
        for guess in preset.assumed:
            typer.echo(f"  assumed: {guess}")


def doctor() -> None:
    """Report Python, the ray tracer's variant, libLLVM, the GPU and installed plug-ins; trace one ray."""
    import platform

    from sionna_radar.foundation.versions import versions
    from sionna_radar.raytracer.backend import describe_backend
    from sionna_radar.scenario.parts import custom_parts
    from sionna_radar.scenario.registry import load_plugins

    backend = describe_backend()
    rows = {
        "Python": f"{platform.python_version()} ({sys.executable})",
        "system": platform.platform(),
        "Dr.Jit variant": f"{backend.variant}, {backend.threads} threads",
        "libLLVM": (
            f"{backend.llvm.version} at {backend.llvm.path} ({backend.llvm.origin})"
            if backend.llvm
            else "not needed: the GPU traces"
        ),
        "GPU": backend.gpu,
        **{name: version or "not installed" for name, version in versions().items() if name != "python"},
    }
    for name, value in rows.items():
        typer.echo(f"{name:16}{value}")
    for origin, names in custom_parts().items():
        typer.echo(f"{'plug-in':16}{origin}: {', '.join(names)}")
    for problem in load_plugins():
        typer.echo(f"{'plug-in':16}{problem}")
    typer.echo("one ray traced: all is well")


def bench(
    quick: Annotated[bool, typer.Option("--quick", help="Smaller runs, noisier ratios.")] = False,
    long: Annotated[
        bool, typer.Option("--long", help="Growth with facets and pulses instead, up to 10,000,000 and 200,000.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Write the ratios as JSON, to compare with later."),
    ] = None,
    compare: Annotated[
        Path | None, typer.Option("--compare", metavar="FILE", help="Tell the ratios of an earlier run beside them.")
    ] = None,
    backend: BackendOption = None,
) -> None:
    """Measure the speed ratios that the program promises, side by side in one run."""
    from sionna_radar.report.bench.file import BENCH_FILE, change, read_bench, write_bench
    from sionna_radar.studies.bench import RATIOS, measure
    from sionna_radar.studies.bench_growth import GROWTH_RATIOS, measure_growth

    if output is not None:
        BENCH_FILE.check(output)
    earlier = read_bench(compare, quick=quick) if compare is not None else {}
    ratios = []
    with progress_of(quiet=False) as progress:
        count, measured = (GROWTH_RATIOS, measure_growth()) if long else (RATIOS, measure(quick=quick))
        progress("ratios", 0, count)
        for ratio in measured:
            ratios.append(ratio)
            progress("ratios", len(ratios), count)
            typer.echo(f"{ratio}{change(ratio, earlier)}")
    if output is not None:
        typer.echo(f"ratios in {write_bench(output, ratios, quick=quick)}")
    missed = sum(not ratio.kept for ratio in ratios)
    if missed:
        typer.echo(f"{missed} of {count} bounds missed", err=True)
        raise typer.Exit(1)


def fit(
    scenario: ScenarioArgument,
    material: Annotated[str, typer.Option("--material", metavar="NAME", help="A material of the scenario.")],
    from_deg: Annotated[float, typer.Option(help="Least incidence angle of the fit.")] = 20.0,
    to_deg: Annotated[float, typer.Option(help="Greatest incidence angle of the fit.")] = 70.0,
    set_: SetOption = None,
    set_file: SetFileOption = None,
) -> None:
    """Report the constant gamma that best matches a material, its residual, and where it fails."""
    from sionna_radar.scenario import load_scenario
    from sionna_radar.studies.gamma_fit import TOLERANCE_DB, fit_material

    log_to_stderr()
    result = fit_material(load_scenario(scenario, overrides_of(set_, set_file, None)), material, from_deg, to_deg)
    typer.echo(f"{material}: gamma = {result.gamma_db:.2f} dB over {from_deg:g} to {to_deg:g} deg")
    typer.echo(f"residual {result.rms_db:.2f} dB RMS over the span\n")
    typer.echo("incidence (deg)  sigma0 (dB)  residual (dB)")
    columns = (result.incidence_deg, result.sigma0_db, result.residual_db)
    for angle, level, residual in list(zip(*columns, strict=True))[::5]:
        typer.echo(f"{angle:15.0f}  {level:11.2f}  {residual:+13.2f}")
    typer.echo(f"\nwhere it misses by more than {TOLERANCE_DB:g} dB:")
    for failure in result.failures or ["nowhere"]:
        typer.echo(f"  {failure}")
