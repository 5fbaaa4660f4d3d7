"""Commands that start, check, list and draw scenarios, and report on the program, without simulating."""

import sys
from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.cli.session import Listed, MapOption, Session, command, progress_shown
from sionna_radar.foundation.errors import OutputError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.new_file import write_new

NO_BYTE_CODE = (
    "not kept (PYTHONDONTWRITEBYTECODE is set): every start compiles all modules, and takes nearly twice as long"
)


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
    if checked.radar.scan.mode == "panoramic":
        typer.echo(to_toml(checked, defaults=every), nl=False)
        typer.echo(
            f"# the keys of {session.scenario} fit together; its drive, which maps no heights, is checked by "
            "`sionna-radar panorama`"
        )
        return
    with session.reach():
        prepared = prepare(checked)
    typer.echo(to_toml(checked, defaults=every), nl=False)
    for key, box in placed_boxes(prepared.world.scene.surfaces).items():
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
        f"about {work.flight_s + work.map_s:.1g} s for flight and map once all is loaded, to an order of magnitude"
    )


def scenes() -> None:
    """List the shipped scenarios."""
    import tomllib

    from sionna_radar.scenario.shipped import shipped_scenarios

    for name, path in shipped_scenarios().items():
        typer.echo(f"{name:16}{tomllib.loads(path.read_text(encoding='utf-8')).get('description', '')}")


def presets() -> None:
    """List the published radars (`radar.preset`) and lidars (`lidar.preset`), with sources and assumptions."""
    from sionna_radar.scenario.presets import LIDAR_PRESETS, PRESETS

    for name, preset in {**PRESETS, **LIDAR_PRESETS}.items():
        typer.echo(f"{name}: {preset.summary}")
        for key, value in preset.keys.items():
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
        **({"byte code": NO_BYTE_CODE} if sys.dont_write_bytecode else {}),
        **{name: version or "not installed" for name, version in versions().items() if name != "python"},
    }
    for name, value in rows.items():
        typer.echo(f"{name:16}{value}")
    for origin, names in custom_parts().items():
        typer.echo(f"{'plug-in':16}{origin}: {', '.join(names)}")
    for problem in load_plugins():
        typer.echo(f"{'plug-in':16}{problem}")
    typer.echo("one ray traced correctly")


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
    flown, takes_it = None, "run"
    if sources:
        from sionna_radar.scenario.loading import parse_scenario, scenario_from, start_text
        from sionna_radar.survey.first_flight import first_flight

        document = scenario_from(sources, path.absolute().parent)
        if path.is_file():
            raise OutputError(f"{path} exists already; name another file")
        if parse_scenario(document).radar.scan.mode == "panoramic":
            takes_it = "panorama"
        else:
            with progress_shown(quiet=False):
                flown = first_flight(document, path.absolute().parent)
        text = start_text(document if flown is None else flown.document, takes_it)
    else:
        text = resources.files("sionna_radar.scenario").joinpath("template.toml").read_text(encoding="utf-8")
    write_new(path, text, "name another file")
    if flown is not None and flown.reason is not None:
        typer.echo(f"scenario in {shown(path)}; it cannot be flown yet: {flown.reason}")
        return
    if flown is not None and flown.shrunk:
        platform = flown.document["platform"]
        said = f"{platform['altitude_m']:g} m high along {platform['length_m']:g} m, as the ground is small"
        typer.echo(f"the flight is {said}")
    typer.echo(f"scenario in {shown(path)}; fly it with: sionna-radar {takes_it} {shown(path)}")


def schema() -> None:
    """Print the JSON Schema of scenarios, for completion and documentation in editors."""
    import json

    from sionna_radar.scenario.reference import scenario_schema

    typer.echo(json.dumps(scenario_schema(), indent=2, ensure_ascii=False))


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
    from sionna_radar.report.coordinates import Coordinates
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


COMMANDS = (
    Listed("Begin", "init", init),
    Listed("Begin", "validate", validate),
    Listed("Begin", "show", show),
    Listed("Reference", "scenes", scenes),
    Listed("Reference", "presets", presets),
    Listed("Reference", "schema", schema),
    Listed("Reference", "doctor", doctor),
)
