"""Command `landing`: where to land on the map of a survey."""

from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.cli.session import Listed, Session, command


@command("output", "quiet")
def landing_command(
    session: Session,
    survey: Annotated[Path, typer.Argument(metavar="SURVEY", help="Folder of results of `run`, `process` or `fuse`.")],
    footprint: Annotated[float, typer.Option(metavar="M", help="Diameter of a landing place, m.")] = 4.0,
    slope: Annotated[float, typer.Option(metavar="DEG", help="Largest slope of its plane, degrees.")] = 7.0,
    roughness: Annotated[float, typer.Option(metavar="M", help="Largest distance of its ground from that, m.")] = 0.2,
    obstacle: Annotated[float, typer.Option(metavar="M", help="Highest rise above the plane around it, m.")] = 0.46,
    clearance: Annotated[float, typer.Option(metavar="M", help="Radius within which nothing is higher, m.")] = 4.6,
    draws: Annotated[int, typer.Option(min=100, max=100_000, help="How often the errors of the map are drawn.")] = 500,
) -> None:
    """Find where to land on a map: the probability that a place is fit, and the best sites with their reasons."""
    from sionna_radar.studies.landing.document import DOCUMENT
    from sionna_radar.studies.landing.results import landing_sites
    from sionna_radar.studies.landing.study import Limits

    limits = Limits(
        footprint_m=footprint, slope_deg=slope, roughness_m=roughness, obstacle_m=obstacle, clearance_m=clearance
    )
    session.produce(lambda _: landing_sites(survey, limits, draws=draws), DOCUMENT)


COMMANDS = (Listed("Study", "landing", landing_command),)
