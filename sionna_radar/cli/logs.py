"""The command that looks into a log of a flight."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sionna_radar.cli.options import OutputOption, QuietOption
from sionna_radar.cli.session import Session

if TYPE_CHECKING:
    from sionna_radar.scenario.bases import TerrainParameters


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command(name="log")(log_command)


def log_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="PX4 .ulg, ArduPilot .bin, .tlog, .gpx or .csv.")],
    output: OutputOption = None,
    over: Annotated[
        str | None, typer.Option(metavar="SCENARIO", help="Draw it over the terrain of a scenario.")
    ] = None,
    terrain: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw it over an elevation file with a CRS.")
    ] = None,
    start: Annotated[float, typer.Option(help="Begin here, s from the first position.")] = 0.0,
    stop: Annotated[float | None, typer.Option(help="End here, s from the first position.")] = None,
    gap: Annotated[float, typer.Option(help="Longest time without a position that is no gap, s.")] = 2.0,
    quiet: QuietOption = False,
) -> None:
    """Show what is inside a log of a flight, and draw it over a map."""
    from sionna_radar.report.log.products import MARKER, write_log
    from sionna_radar.report.log.table import print_log
    from sionna_radar.studies.log_inspection import inspect_log

    ground = _ground(over, terrain)
    Session.of(str(file), output, None, None, None, quiet).produce(
        lambda _, __: inspect_log(file, ground, start_s=start, stop_s=stop, gap_s=gap),
        suffix="_log",
        marker=MARKER,
        write=write_log,
        show=print_log,
    )


def _ground(over: str | None, terrain: Path | None) -> "TerrainParameters | None":
    from sionna_radar.foundation.errors import Problem, ScenarioError
    from sionna_radar.scenario import load_scenario
    from sionna_radar.scenario.terrain import RasterTerrain

    if over is not None and terrain is not None:
        raise ScenarioError([Problem("--terrain", "contradicts --over; give the one or the other")], "command line")
    if terrain is not None:
        return RasterTerrain(path=terrain)
    return load_scenario(over).terrain if over is not None else None
