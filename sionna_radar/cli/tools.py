"""Commands that plan, check, draw and report without simulating."""

import sys
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sionna_radar.cli.session import (
    RECORDING,
    ApplyShiftOption,
    MapOption,
    MeasuredHeights,
    QuietOption,
    ReferenceOption,
    ReferenceSigmaOption,
    Session,
    command,
    log_to_stderr,
    progress_shown,
)
from sionna_radar.foundation.errors import OutputError, ScenarioError
from sionna_radar.foundation.input_file import shown

if TYPE_CHECKING:
    from sionna_radar.scenario.bases import TerrainParameters


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
    from sionna_radar.report.studies.flights import PLAN_FILE, parse_pair, print_check, print_plan
    from sionna_radar.scenario import load_scenario, to_toml
    from sionna_radar.studies.planning import Wanted, check_plan, plan_flight, planned_scenario

    log_to_stderr()
    if calibration:
        _plan_calibration(base, output, area, sampling)
        return
    if area is None or sampling is None:
        missing = "--area" if area is None else "--sampling"
        raise ScenarioError.of(missing, "is missing; add it, or --calibration", "command line")
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
    """Write the two parts of a calibration flight."""
    from sionna_radar.report.studies.flights import PLAN_FILE
    from sionna_radar.scenario import load_scenario, to_toml
    from sionna_radar.studies.planning import calibration_flights

    if base is None or area is not None or sampling is not None:
        key, remedy = ("--base", "is needed") if base is None else ("--calibration", "takes no --area and --sampling")
        raise ScenarioError.of(key, f"{remedy}: ground, radar and height are the base's", "command line")
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


@command("scenario", "set_", "set_file", "seed", "network")
def validate(
    session: Session,
    every: Annotated[bool, typer.Option("--all", help="Print every key, those with their defaults too.")] = False,
) -> None:
    """Check a scenario with its terrain and flight, and print what differs from the defaults."""
    from sionna_radar.scenario import to_toml
    from sionna_radar.scene.objects import placed_boxes
    from sionna_radar.survey.preparation import prepare
    from sionna_radar.survey.work import expected_work

    checked = session.load()
    with session.reach():
        prepared = prepare(checked)
    typer.echo(to_toml(checked, defaults=every), nl=False)
    for key, box in placed_boxes(prepared.scene.scene.surfaces).items():
        typer.echo(f"# {key} stands at {box}")
    grid, (start_s, end_s) = prepared.mapper.grid, prepared.flight.trajectory.cruise_s()
    warnings = f"{len(prepared.warnings)} warning{'s' if len(prepared.warnings) != 1 else ''}"
    typer.echo(
        f"# {session.scenario} can be flown: {len(prepared):,} pulses in {end_s - start_s:.1f} s, "
        f"DEM of {grid.columns} x {grid.rows} cells of {grid.spacing_m:g} m, {warnings}"
    )
    work = expected_work(prepared)
    typer.echo(
        f"# expected: {work.paths:.2g} paths, {work.memory_mb / 1000:.1f} GB of memory, and on two cores "
        f"about {work.flight_s + work.map_s:.1g} s for flight and map once all is loaded"
    )


def scenes() -> None:
    """List the shipped scenarios."""
    import tomllib

    from sionna_radar.scenario import shipped_scenarios

    for name, path in shipped_scenarios().items():
        typer.echo(f"{name:16}{tomllib.loads(path.read_text(encoding='utf-8')).get('description', '')}")


def presets() -> None:
    """List the published radars available as `radar.preset`, with sources and assumptions."""
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

    from sionna_radar.execution.workers import versions
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
    typer.echo("one ray traced correctly")


@command("scenario", "set_", "set_file")
def fit(
    session: Session,
    material: Annotated[str, typer.Option("--material", metavar="NAME", help="A material of the scenario.")],
    from_deg: Annotated[float, typer.Option(help="Least incidence angle of the fit.")] = 20.0,
    to_deg: Annotated[float, typer.Option(help="Greatest incidence angle of the fit.")] = 70.0,
) -> None:
    """Fit a constant gamma to a material; print its residual and where the fit fails."""
    from sionna_radar.studies.crosscheck import TOLERANCE_DB, fit_material

    result = fit_material(session.load(), material, from_deg, to_deg)
    typer.echo(f"{material}: gamma = {result.gamma_db:.2f} dB over {from_deg:g} to {to_deg:g} deg")
    typer.echo(f"residual {result.rms_db:.2f} dB RMS over the span\n")
    typer.echo("incidence (deg)  sigma0 (dB)  residual (dB)")
    columns = (result.incidence_deg, result.sigma0_db, result.residual_db)
    for angle, level, residual in list(zip(*columns, strict=True))[::5]:
        typer.echo(f"{angle:15.0f}  {level:11.2f}  {residual:+13.2f}")
    typer.echo(f"\nwhere it misses by more than {TOLERANCE_DB:g} dB:")
    for failure in result.failures or ["nowhere"]:
        typer.echo(f"  {failure}")


@command("scenario", *RECORDING)
def fit_materials_command(
    session: Session,
    levels: Annotated[
        Path | None,
        typer.Option(
            "--levels",
            metavar="FILE",
            help="CSV of cover,incidence_deg,polarization,sigma0_db[,looks]; polarization VV, HH, HV or an "
            "angle in deg. Default: measured from traced echoes of the scenario.",
        ),
    ] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(
            "--free",
            metavar="COVER.KEY",
            help="A parameter to estimate (repeat). Default: gamma, or height, length, permittivity and loss.",
        ),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            "--prior",
            metavar="NAME=VALUE",
            help="Known beforehand to (repeat): a factor for heights, lengths and permittivities, else in its unit.",
        ),
    ] = None,
    calibration_sigma_db: Annotated[
        float,
        typer.Option("--calibration-sigma-db", metavar="DB", min=0.0, help="Unknown level of the radar, dB."),
    ] = 0.0,
    level_sigma_db: Annotated[
        float,
        typer.Option("--level-sigma-db", metavar="DB", min=0.0, help="Error of each level beside speckle, dB."),
    ] = 0.0,
    pulses: Annotated[int, typer.Option(metavar="N", min=1, help="Pulses taken, without --levels.")] = 2000,
    recording: Annotated[
        Path | None,
        typer.Option(
            "--recording",
            metavar="FILE",
            help="Levels of the recorded echoes of this flight, or of its folder of `run --record signals`.",
        ),
    ] = None,
) -> None:
    """Estimate gamma, roughness and permittivity of covers from levels of backscatter."""
    from sionna_radar.report.studies.material_fit import MARKER, print_materials, write_materials
    from sionna_radar.studies.calibration import parse_deviations
    from sionna_radar.studies.material_fit import fit_materials, measure_levels
    from sionna_radar.surfaces.backscatter import Levels
    from sionna_radar.survey.preparation import prepare

    if levels is not None and recording is not None:
        raise ScenarioError.of("--recording", "gives levels, as --levels does; give one of them", "command line")
    priors, given = parse_deviations("--prior", prior or []), None if levels is None else Levels.from_csv(levels)
    loaded = session.load()
    session.produce(
        lambda _: fit_materials(
            measure_levels(prepare(loaded), pulses, recording) if given is None else given,
            loaded.all_materials,
            loaded.radar.carrier_hz,
            free=free or (),
            prior=priors,
            calibration_sigma_db=calibration_sigma_db,
            level_sigma_db=level_sigma_db,
        ),
        suffix="_materials",
        marker=MARKER,
        write=write_materials,
        show=print_materials,
    )


def init(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Where the scenario goes, such as my_survey.toml.")],
    sources: Annotated[
        list[str] | None,
        typer.Option(
            "--from",
            metavar="SOURCE",
            help="Elevation raster, point cloud, mesh, flight log, or a preset's name; repeat for several.",
        ),
    ] = None,
) -> None:
    """Write a scenario to start from: a commented one, or one over your terrain, along your log, with your radar."""
    path = file.expanduser()
    flown = None
    if sources:
        from sionna_radar.scenario.loading import scenario_from, start_text
        from sionna_radar.studies.first_flight import first_flight

        document = scenario_from(sources, path.absolute().parent)
        if path.is_file():
            raise OutputError(f"{path} exists already; name another file")
        with progress_shown(quiet=False):
            flown = first_flight(document, path.absolute().parent)
        text = start_text(flown.document)
    else:
        text = resources.files("sionna_radar.scenario").joinpath("template.toml").read_text(encoding="utf-8")
    try:
        with path.open("x", encoding="utf-8", newline="\n") as new:
            new.write(text)
    except FileExistsError as error:
        raise OutputError(f"{path} exists already; name another file") from error
    except (OSError, ValueError) as error:
        message = f"{path} cannot be written ({getattr(error, 'strerror', None) or error}); name another file"
        raise OutputError(message) from error
    if flown is not None and flown.reason is not None:
        typer.echo(f"scenario in {shown(path)}; it cannot be flown yet: {flown.reason}")
        return
    if flown is not None and flown.shrunk:
        platform = flown.document["platform"]
        said = f"{platform['altitude_m']:g} m high along {platform['length_m']:g} m, as the ground is small"
        typer.echo(f"the flight is {said}")
    typer.echo(f"scenario in {shown(path)}; fly it with: sionna-radar run {shown(path)}")


def schema() -> None:
    """Print the JSON Schema of scenarios, for completion and documentation in editors."""
    import json

    from sionna_radar.scenario.reference import scenario_schema

    typer.echo(json.dumps(scenario_schema(), indent=2, ensure_ascii=False))


@command("output", "quiet")
def log_command(
    session: Session,
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="PX4 .ulg, ArduPilot .bin, .tlog, SBET .out, .gpx, .csv or .trj.")
    ],
    over: Annotated[
        str | None, typer.Option(metavar="SCENARIO", help="Draw it over the terrain of a scenario.")
    ] = None,
    terrain: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw it over an elevation file with a CRS.")
    ] = None,
    start: Annotated[float, typer.Option(help="Start, s after the first position.")] = 0.0,
    stop: Annotated[float | None, typer.Option(help="End, s after the first position.")] = None,
    gap: Annotated[float, typer.Option(help="Longest interval between positions that is no gap, s.")] = 2.0,
    crs: Annotated[
        str | None, typer.Option(metavar="CRS", help="CRS of a CSV log in map coordinates, e.g. EPSG:25832.")
    ] = None,
) -> None:
    """Summarise a flight log, and draw it on a map."""
    from sionna_radar.report.studies.flights import MARKER, print_log, write_log
    from sionna_radar.studies.log_inspection import inspect_log

    ground = _ground(over, terrain)
    session.produce(
        lambda _: inspect_log(file, ground, start_s=start, stop_s=stop, gap_s=gap, crs=crs),
        suffix="_log",
        marker=MARKER,
        write=write_log,
        show=print_log,
    )


def _ground(over: str | None, terrain: Path | None) -> "TerrainParameters | None":
    from sionna_radar.scenario import load_scenario
    from sionna_radar.scenario.terrain import RasterTerrain

    if over is not None and terrain is not None:
        raise ScenarioError.of("--terrain", "contradicts --over; give the one or the other", "command line")
    if terrain is not None:
        return RasterTerrain(path=terrain)
    return load_scenario(over).terrain if over is not None else None


@command("scenario", "set_", "set_file", "network", "quiet")
def show(
    session: Session,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="DIR", help="Folder for show.html, or a file .html; default results/NAME_show."
        ),
    ] = None,
    map_coordinates: MapOption = True,
) -> None:
    """Draw the scene, the flight and its footprints as an interactive 3-D page, without tracing."""
    from sionna_radar.report.drawing import Coordinates
    from sionna_radar.report.files.folder import check_output
    from sionna_radar.report.page.show import MARKER, PAGE_FILE, show_page, write_page
    from sionna_radar.survey.preparation import prepare

    name = Path(session.scenario).stem
    path = output or Path("results") / f"{name}_show"
    in_folder = path.suffix.lower() not in (".html", ".htm")
    path = check_output(path, MARKER) if in_folder else PAGE_FILE.check(path)
    checked = session.load()
    with session.reach():
        prepared = prepare(checked)
    coordinates = Coordinates.MAP if map_coordinates else Coordinates.LOCAL
    page = show_page(prepared, name, coordinates)
    written = write_page(page, path) if in_folder else PAGE_FILE.write(path, page)
    if not session.quiet:
        typer.echo(f"page in {shown(written)}")


def compare(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR1 DIR2 ...", help="Folders of results of `run`; or of `sweep` and `design`."),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder for compare.html (default: none).")
    ] = None,
    reference: ReferenceOption = None,
    reference_sigma: ReferenceSigmaOption = 0.0,
    apply_shift: ApplyShiftOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compare several results: errors, differing settings, and maps side by side, or with measured heights."""
    from sionna_radar.report.files.folder import check_output
    from sionna_radar.report.page.compare import (
        MARKER,
        compare_folder,
        print_comparison,
        print_references,
        read_results,
        write_comparison,
    )
    from sionna_radar.report.studies.radar_design import is_study, print_studies
    from sionna_radar.studies.comparison import compare_results

    log_to_stderr(quiet)
    if any(is_study(folder) for folder in folders):
        if output is not None or reference is not None:
            option = "--reference" if output is None else "-o"
            raise ScenarioError.of(option, "is for folders of `run`; leave it out for studies", "command line")
        print_studies(folders)
        return
    directory = check_output(output, MARKER) if output else None
    heights = MeasuredHeights(reference, reference_sigma, apply_shift)
    if heights.path is not None:
        checks = [compare_folder(folder, heights.path, reference_sigma, apply_shift) for folder in folders]
        if not quiet:
            print_references(folders, checks)
        if len(folders) == 1 and directory is None:
            return
    result = compare_results(read_results(folders))
    written = write_comparison(result, directory) if directory else []
    if not quiet:
        print_comparison(result)
        if directory:
            typer.echo(f"{len(written)} files in {shown(directory)}")
