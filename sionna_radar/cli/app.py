"""The command line: `sionna-radar COMMAND`.

Exit codes: 0 done, 2 bad input (one clear error on standard error, nothing written), 130 and 143 interrupted by Ctrl-C
or SIGTERM, 1 anything else: engines that cannot run, a missed bound of `bench`, a sweep with cells that cannot be
flown, results that had to go elsewhere. The heavy libraries are imported inside the commands, so that `--help`
answers at once.
"""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sionna_radar.foundation.errors import BackendError, KeptElsewhereError, RadarError
from sionna_radar.foundation.interrupts import Interrupted, held_back
from sionna_radar.report.folder import check_output

if TYPE_CHECKING:
    from sionna_radar.foundation.progress import Progress
    from sionna_radar.scenario import Scenario

DEMO = "san_francisco"

app = typer.Typer(
    help="Simulate airborne millimetre-wave terrain radar, from ray-traced fields to a DEM and its error.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

ScenarioArgument = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="A TOML file, or the name of a shipped scenario.")
]
OutputOption = Annotated[
    Path | None, typer.Option("-o", "--output", metavar="DIR", help="Where results go; default results/NAME.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Replace a value by its dotted key, e.g. radar.antenna.beamwidth_deg=4; KEY=none removes it.",
    ),
]
SetFileOption = Annotated[
    list[Path] | None,
    typer.Option("--set-file", metavar="FILE", help="Merge the tables of a TOML file into the scenario, before --set."),
]
SeedOption = Annotated[int | None, typer.Option(help="Replace the scenario's seed.")]
BlockOption = Annotated[
    int | None, typer.Option(min=1, help="Pulses simulated at once; changes speed and memory, never the result.")
]
MapOption = Annotated[
    bool,
    typer.Option(
        "--map-coordinates/--local-coordinates",
        help="Coordinates in figures: those of the map where the terrain has a place on it, or local ones.",
    ),
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]


def main() -> None:
    """Run the command line."""
    from sionna_radar.report.terminal import print_on_any_encoding

    print_on_any_encoding()
    with _errors_told():
        app()


def _print_version(wanted: bool) -> bool:
    if wanted:
        import sionna_radar

        typer.echo(f"sionna-radar {sionna_radar.__version__}")
        raise typer.Exit
    return wanted


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version and exit.")
    ] = False,
) -> None:
    # Only declares --version, which its own callback answers; a docstring would replace the program's help.
    pass


@app.command()
def demo(output: OutputOption = None, map_coordinates: MapOption = True, quiet: QuietOption = False) -> None:
    """Fly a real survey over San Francisco, and write its figures and numbers."""
    _fly(DEMO, output or Path("results/demo"), {}, None, map_coordinates, quiet)


@app.command(name="run")
def run_command(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    set_: SetOption = None,
    set_file: SetFileOption = None,
    seed: SeedOption = None,
    block_size: BlockOption = None,
    map_coordinates: MapOption = True,
    quiet: QuietOption = False,
) -> None:
    """Fly a scenario and write its DEM, points, errors and figures."""
    overrides = _overrides(set_, set_file, seed)
    _fly(scenario, output or Path("results") / Path(scenario).stem, overrides, block_size, map_coordinates, quiet)


@app.command()
def crosscheck(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    set_: SetOption = None,
    set_file: SetFileOption = None,
    seed: SeedOption = None,
    quiet: QuietOption = False,
) -> None:
    """Fly a scenario with both engines on the same pulses, and say whether they agree; exit code 1 if not."""
    from sionna_radar.report.terminal import number
    from sionna_radar.studies import crosscheck as check

    _log_to_stderr(quiet)
    checked = _load(scenario, _overrides(set_, set_file, seed))
    directory = check_output(output or Path("results") / f"{Path(scenario).stem}_crosscheck", check.MARKER)
    with _progress(quiet) as progress:
        result = check.crosscheck(checked, progress=progress)
    written = check.write(result, directory)
    if not quiet:
        for name, part in result.verdict().items():
            word = "agrees" if part["agrees"] else "DIFFERS"
            value = number(part["value"], "+.4f")
            chance = f"   (by speckle alone: {part['probability']:.4f})" if "probability" in part else ""
            typer.echo(f"{name:32}{value:>10}   within {number(part['tolerance'], '.4f')}   {word}{chance}")
        typer.echo(f"the engines {'agree' if result.agrees else 'DIFFER'}; {len(written)} files in {directory}")
        typer.echo("shared by both, so not checked: ray casting, antenna, backscatter models, targets, mirrors")
    if not result.agrees:
        raise typer.Exit(1)


@app.command()
def budget(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    repeat: Annotated[int, typer.Option(min=1, help="Draws of the random errors.")] = 5,
    grades: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Custom grades of GPS/IMU: TOML tables of platform.navigation keys."),
    ] = None,
    set_: SetOption = None,
    set_file: SetFileOption = None,
    seed: SeedOption = None,
    quiet: QuietOption = False,
) -> None:
    """Find how good GPS and IMU must be: the size of each error that alone makes the RMS of the DEM grow by 10 %."""
    from sionna_radar.flight.grades import GRADES, load_grades
    from sionna_radar.report.budget.table import print_budget
    from sionna_radar.studies import budget as study

    _log_to_stderr(quiet)
    checked = _load(scenario, _overrides(set_, set_file, seed))
    known = GRADES | load_grades(grades) if grades else GRADES
    directory = check_output(output or Path("results") / f"{Path(scenario).stem}_budget", study.MARKER)
    with _progress(quiet) as progress:
        result = study.navigation_budget(checked, repeat=repeat, grades=known, progress=progress)
    written = study.write(result, directory)
    if not quiet:
        print_budget(result)
        typer.echo(f"{len(written)} files in {directory}")


@app.command()
def image(
    scenario: ScenarioArgument,
    output: OutputOption = None,
    set_: SetOption = None,
    set_file: SetFileOption = None,
    seed: SeedOption = None,
    quiet: QuietOption = False,
) -> None:
    """Fly a side-looking scenario and write its slant-range image and, with persistent speckle, the focused one."""
    from sionna_radar.report.imagery.table import print_image
    from sionna_radar.studies import images as imaging

    _log_to_stderr(quiet)
    checked = _load(scenario, _overrides(set_, set_file, seed))
    directory = check_output(output or Path("results") / f"{Path(scenario).stem}_image", imaging.MARKER)
    with _progress(quiet) as progress:
        result = imaging.fly_images(checked, progress=progress)
    written = imaging.write(result, directory)
    if not quiet:
        print_image(result)
        typer.echo(f"{len(written)} files in {directory}")


@app.command()
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
    from sionna_radar.report.plan.file import check_plan_file, write_plan_file
    from sionna_radar.report.plan.table import parse_pair, print_check, print_plan
    from sionna_radar.scenario import to_toml
    from sionna_radar.studies.plan_check import check_plan
    from sionna_radar.studies.planning import Wanted, plan_flight, planned_scenario

    _log_to_stderr(quiet=False)
    check_plan_file(output)
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
    taken = _load(base, {}) if base else None
    planned = plan_flight(wanted, taken)
    scenario = planned_scenario(planned, taken)
    with _progress(quiet=False) as progress:
        checked = check_plan(planned, scenario, progress)
    write_plan_file(output, to_toml(scenario))
    print_plan(planned)
    print_check(checked)
    typer.echo(f"scenario in {output}")


@app.command()
def sweep(
    scenario: ScenarioArgument,
    vary: Annotated[
        list[str],
        typer.Option("--vary", metavar="KEY=V1,V2,...", help="Values of a dotted key; repeat for all combinations."),
    ],
    repeat: Annotated[int, typer.Option(min=1, metavar="N", help="Seeds for each combination.")] = 1,
    output: OutputOption = None,
    set_: SetOption = None,
    set_file: SetFileOption = None,
    seed: SeedOption = None,
    quiet: QuietOption = False,
) -> None:
    """Fly a scenario for every combination of some values, and tabulate and draw the error of its DEM."""
    from sionna_radar.report.sweep.products import MARKER, write_sweep
    from sionna_radar.report.sweep.table import print_sweep
    from sionna_radar.studies.sweep import fly_sweep, parse_axes, plan_sweep

    _log_to_stderr(quiet)
    axes = parse_axes(vary)
    directory = check_output(output or Path("results") / f"{Path(scenario).stem}_sweep", MARKER)
    with _progress(quiet) as progress:
        plan = plan_sweep(scenario, axes, repeat, _overrides(set_, set_file, seed), progress)
        result = fly_sweep(plan, progress=progress)
    if any(case.runs for case in result.cases):
        with held_back():
            written = write_sweep(result, directory)
        if not quiet:
            print_sweep(result)
            typer.echo(f"{len(written)} files in {directory}")
    if result.interrupted:
        raise Interrupted
    if result.failed:
        failed = sum(bool(case.reason) for case in result.cases)
        typer.echo(f"{failed} of {len(result.cases)} combinations could not be flown in full", err=True)
        raise typer.Exit(1)


@app.command()
def validate(
    scenario: ScenarioArgument, set_: SetOption = None, set_file: SetFileOption = None, seed: SeedOption = None
) -> None:
    """Check a scenario, its terrain and its flight included, and print it with all values resolved."""
    from sionna_radar.scenario import to_toml
    from sionna_radar.survey.preparation import prepare

    _log_to_stderr(quiet=False)
    checked = _load(scenario, _overrides(set_, set_file, seed))
    prepare(checked)
    typer.echo(to_toml(checked), nl=False)


@app.command()
def scenes() -> None:
    """List the shipped scenarios."""
    import tomllib

    from sionna_radar.scenario import shipped_scenarios

    for name, path in shipped_scenarios().items():
        typer.echo(f"{name:16}{tomllib.loads(path.read_text(encoding='utf-8')).get('description', '')}")


@app.command()
def doctor() -> None:
    """Report Python, the ray tracer's variant, libLLVM and where it was found, and the GPU; trace one ray."""
    import platform

    from sionna_radar.raytracer.backend import describe_backend
    from sionna_radar.report.survey.summary import versions

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
    typer.echo("one ray traced: all is well")


@app.command()
def bench(
    quick: Annotated[bool, typer.Option("--quick", help="Smaller runs, noisier ratios.")] = False,
) -> None:
    """Measure the speed ratios that the program promises, side by side in one run."""
    from sionna_radar.studies.bench import RATIOS, measure

    missed = 0
    with _progress(quiet=False) as progress:
        progress("ratios", 0, RATIOS)
        for done, ratio in enumerate(measure(quick=quick), start=1):
            progress("ratios", done, RATIOS)
            typer.echo(ratio)
            missed += not ratio.kept
    if missed:
        typer.echo(f"{missed} of {RATIOS} bounds missed", err=True)
        raise typer.Exit(1)


@app.command()
def fit(
    scenario: ScenarioArgument,
    material: Annotated[str, typer.Option("--material", metavar="NAME", help="A material of the scenario.")],
    from_deg: Annotated[float, typer.Option(help="Least incidence angle of the fit.")] = 20.0,
    to_deg: Annotated[float, typer.Option(help="Greatest incidence angle of the fit.")] = 70.0,
    set_: SetOption = None,
    set_file: SetFileOption = None,
) -> None:
    """Report the constant gamma that best matches a material, its residual, and where it fails."""
    from sionna_radar.studies.gamma_fit import TOLERANCE_DB, fit_material

    _log_to_stderr(quiet=False)
    result = fit_material(_load(scenario, _overrides(set_, set_file, None)), material, from_deg, to_deg)
    typer.echo(f"{material}: gamma = {result.gamma_db:.2f} dB over {from_deg:g} to {to_deg:g} deg")
    typer.echo(f"residual {result.rms_db:.2f} dB RMS over the span\n")
    typer.echo("incidence (deg)  sigma0 (dB)  residual (dB)")
    columns = (result.incidence_deg, result.sigma0_db, result.residual_db)
    for angle, level, residual in list(zip(*columns, strict=True))[::5]:
        typer.echo(f"{angle:15.0f}  {level:11.2f}  {residual:+13.2f}")
    typer.echo(f"\nwhere it misses by more than {TOLERANCE_DB:g} dB:")
    for failure in result.failures or ["nowhere"]:
        typer.echo(f"  {failure}")


def _fly(
    scenario: str,
    output: Path,
    overrides: dict[str, object],
    block_size: int | None,
    map_coordinates: bool,
    quiet: bool,
) -> None:
    from sionna_radar.report.coordinates import Coordinates
    from sionna_radar.report.survey.products import MARKER, write_products
    from sionna_radar.report.survey.table import print_survey
    from sionna_radar.survey.chain import BLOCK_SIZE, run

    _log_to_stderr(quiet)
    checked = _load(scenario, overrides)
    directory = check_output(output, MARKER)
    with _progress(quiet) as progress:
        survey = run(checked, block_size=block_size or BLOCK_SIZE, progress=progress)
    coordinates = Coordinates.MAP if map_coordinates else Coordinates.LOCAL
    written = write_products(survey, directory, coordinates)
    if not quiet:
        print_survey(survey)
        typer.echo(f"{len(written)} files in {directory}")
        if checked.radar.scan.mode == "side_looking":
            typer.echo(f"this radar looks to the side: `sionna-radar image {scenario}` makes its image")


def _load(scenario: str, overrides: dict[str, object]) -> "Scenario":
    from sionna_radar.scenario import load_scenario

    return load_scenario(scenario, overrides)


def _overrides(assignments: list[str] | None, files: list[Path] | None, seed: int | None) -> dict[str, object]:
    from sionna_radar.scenario.loading import parse_overrides, read_overrides

    overrides: dict[str, object] = {}
    for file in files or []:
        overrides |= read_overrides(file)
    overrides |= parse_overrides(assignments or [])
    return overrides if seed is None else {**overrides, "seed": seed}


@contextmanager
def _progress(quiet: bool) -> "Iterator[Progress]":
    """Show how far a computation is, unless nobody wants to know."""
    from sionna_radar.report.terminal import quiet_progress, shown_progress

    if quiet:
        yield quiet_progress()
        return
    with shown_progress() as progress:
        yield progress


def _log_to_stderr(quiet: bool) -> None:
    logger = logging.getLogger("sionna_radar")
    if not logger.handlers:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
        logger.addHandler(handler)
    logger.setLevel(logging.ERROR if quiet else logging.WARNING)


@contextmanager
def _errors_told() -> Iterator[None]:
    """Turn errors of the user's making into one message and exit code 2."""
    try:
        yield
    except (BackendError, KeptElsewhereError) as error:
        typer.echo(f"error: {error}", err=True)
        sys.exit(1)
    except RadarError as error:
        typer.echo(f"error: {error}", err=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
