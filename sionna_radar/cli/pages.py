"""The commands that make pages to look at: a scenario before it is flown, and results side by side."""

from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.cli.options import MapOption, NetworkOption, QuietOption, ScenarioArgument, SetFileOption, SetOption
from sionna_radar.cli.session import Session, log_to_stderr
from sionna_radar.foundation.input_file import shown


def add_to(app: typer.Typer) -> None:
    """Add the commands, in the order that `--help` lists them."""
    app.command()(show)
    app.command()(compare)


def show(
    scenario: ScenarioArgument,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="The page; default NAME_show.html.")
    ] = None,
    set_: SetOption = None,
    set_file: SetFileOption = None,
    network: NetworkOption = False,
    map_coordinates: MapOption = True,
    quiet: QuietOption = False,
) -> None:
    """Show the world, the flight and its footprints before anything is traced, as a page in three dimensions."""
    from sionna_radar.report.coordinates import Coordinates
    from sionna_radar.report.show.file import PAGE_FILE
    from sionna_radar.report.show.page import show_page
    from sionna_radar.survey.preparation import prepare

    session = Session.of(scenario, None, set_, set_file, None, quiet, network=network)
    name = Path(scenario).stem
    path = PAGE_FILE.check(output or Path(f"{name}_show.html"))
    checked = session.load()
    with session.reach():
        prepared = prepare(checked)
    coordinates = Coordinates.MAP if map_coordinates else Coordinates.LOCAL
    PAGE_FILE.write(path, show_page(prepared, name, coordinates))
    if not quiet:
        typer.echo(f"page in {shown(path)}")


def compare(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR1 DIR2 ...", help="Folders of results of `run`.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="A folder for compare.html; without it none.")
    ] = None,
    quiet: QuietOption = False,
) -> None:
    """Compare several results: their errors, what differs in their settings, and their maps side by side."""
    from sionna_radar.report.compare.page import MARKER, write_comparison
    from sionna_radar.report.compare.reading import read_results
    from sionna_radar.report.compare.table import print_comparison
    from sionna_radar.report.folder import check_output
    from sionna_radar.studies.comparison import compare_results

    log_to_stderr(quiet)
    directory = check_output(output, MARKER) if output else None
    result = compare_results(read_results(folders))
    written = write_comparison(result, directory) if directory else []
    if not quiet:
        print_comparison(result)
        if directory:
            typer.echo(f"{len(written)} files in {shown(directory)}")
