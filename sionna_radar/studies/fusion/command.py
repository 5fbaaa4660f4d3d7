"""Command `fuse`: one DEM from several sources."""

from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.cli.session import RECORDING, Listed, ReportOption, Session, command
from sionna_radar.foundation.errors import ScenarioError


@command(*RECORDING)
def fuse_command(
    session: Session,
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE1 SOURCE2 ...",
            help="Folders of results of `run` or `process`, recordings, LAS or LAZ clouds, or elevation rasters.",
        ),
    ],
    sigma: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[SOURCE=]M",
            help="Standard deviation of clouds and rasters that state none, m, or of one of them. Repeatable.",
        ),
    ] = None,
    spacing: Annotated[
        float | None, typer.Option(metavar="M", help="Size of the cells, m; default: those of the finest raster.")
    ] = None,
    align_to: Annotated[
        Path | None,
        typer.Option("--align-to", metavar="SOURCE", help="Take the shifts of all others against this source out."),
    ] = None,
    report: ReportOption = True,
) -> None:
    """Fuse surveys, recordings, clouds and DEMs into one DEM with its uncertainty, tested for consistency first."""
    from sionna_radar.studies.fusion.document import DOCUMENT
    from sionna_radar.studies.fusion.study import fuse

    session.produce(
        lambda _: fuse(
            sources,
            sigma_m=_sigma_m(sigma or []),
            spacing_m=spacing,
            align_to=align_to,
            overrides=session.overrides,
        ),
        DOCUMENT,
        report=report,
    )


def _sigma_m(texts: list[str]) -> dict[str, float] | float | None:
    """Return standard deviations by source, or one for all that state none; ScenarioError for other texts."""
    stated: dict[str, float] = {}
    for text in texts:
        source, separator, number = text.rpartition("=")
        try:
            stated[source if separator else ""] = float(number)
        except ValueError as error:
            message = f"{text!r} is no standard deviation; give 0.1, or dem.tif=0.1"
            raise ScenarioError.of_option("--sigma", message) from error
    if "" in stated and len(stated) > 1:
        raise ScenarioError.of_option("--sigma", "is given for all sources and for one; name each of them")
    return stated.get("", stated or None)


COMMANDS = (Listed("Study", "fuse", fuse_command),)
