"""Command `twin`: a recording beside its simulation."""

from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.cli.session import RECORDING, Listed, ReportOption, Session, command


@command(*RECORDING)
def twin_command(
    session: Session,
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="As for `process`, with poses.")],
    terrain: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Elevation raster of the ground; default: the scenario's own.")
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(metavar="SCENARIO", help="Radar and material, for a recording that holds no scenario of its own."),
    ] = None,
    report: ReportOption = True,
) -> None:
    """Simulate a recording's flight over a reference, and test where measured and simulated signals differ."""
    from sionna_radar.studies.twin.document import DOCUMENT
    from sionna_radar.studies.twin.study import twin as run_twin

    session.produce(
        lambda _: run_twin(recording, terrain=terrain, base=base, overrides=session.overrides),
        DOCUMENT,
        report=report,
    )


COMMANDS = (Listed("Real data", "twin", twin_command),)
