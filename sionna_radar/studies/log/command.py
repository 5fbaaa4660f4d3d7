"""Command `log`: summary and map of a flight log."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sionna_radar.cli.session import Listed, Session, command
from sionna_radar.foundation.errors import ScenarioError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sionna_radar.scenario.bases import TerrainParameters


@command("output", "quiet")
def log_command(
    session: Session,
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="PX4 .ulg, ArduPilot .bin, .tlog, SBET .out, .gpx, .csv or .trj.")
    ],
    over: Annotated[
        str | None,
        typer.Option(
            metavar="SCENARIO",
            help="Draw it over the terrain of a scenario; if it flies this log, by its log_columns.",
        ),
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
    from sionna_radar.studies.log.document import DOCUMENT
    from sionna_radar.studies.log.study import inspect_log

    ground, columns = _ground_and_columns(file, over, terrain)
    session.produce(
        lambda _: inspect_log(file, ground, start_s=start, stop_s=stop, gap_s=gap, crs=crs, columns=columns), DOCUMENT
    )


def _ground_and_columns(
    file: Path, over: str | None, terrain: Path | None
) -> "tuple[TerrainParameters | None, Mapping[str, str]]":
    from sionna_radar.scenario import load_scenario
    from sionna_radar.scenario.terrain import RasterTerrain

    if over is not None and terrain is not None:
        raise ScenarioError.of_option("--terrain", "contradicts --over; give the one or the other")
    if over is not None:
        scenario = load_scenario(over)
        own = scenario.platform.log is not None and scenario.platform.log.resolve() == file.resolve()
        return scenario.terrain, scenario.platform.log_columns if own else {}
    return (None if terrain is None else RasterTerrain(path=terrain)), {}


COMMANDS = (Listed("Real data", "log", log_command),)
