"""Command `panorama`: images of a panoramic radar."""

from typing import Annotated

import typer

from sionna_radar.cli.session import SCENARIO, Listed, Session, command


@command(*SCENARIO)
def panorama(
    session: Session,
    spacing: Annotated[
        float, typer.Option(metavar="M", min=0.01, max=100.0, help="Spacing of the pixels on the ground, m.")
    ] = 0.5,
    reach: Annotated[
        float | None,
        typer.Option(metavar="M", min=1.0, help="Range up to which the mosaic uses a turn, m; default: two thirds."),
    ] = None,
    along: Annotated[
        str, typer.Option(metavar="true|measured", help="Way along which the mosaic is laid.")
    ] = "measured",
    every: Annotated[int, typer.Option(metavar="N", min=1, help="Raster and picture of every Nth turn.")] = 50,
) -> None:
    """Write the images of a panoramic radar, one a turn, and their mosaic along the way.

    panorama.nc holds the polar images, for `slam` and for your own programs; turns/ scan-converted ones as GeoTIFF.
    """
    from functools import partial

    from sionna_radar.foundation.errors import ScenarioError
    from sionna_radar.studies.panorama.document import document_of, mosaic_grid
    from sionna_radar.studies.panorama.study import panorama as run_panorama

    if along not in ("true", "measured"):
        raise ScenarioError.of_option("--along", f"{along!r}: give true or measured")
    checked = session.load()
    document = document_of(spacing_m=spacing, reach_m=reach, along=along, every=every)
    # A mosaic of too many pixels is refused before the drive.
    accept = partial(mosaic_grid, spacing_m=spacing, reach_m=reach, along=along)
    session.produce(lambda _: run_panorama(checked, accept=accept), document)


COMMANDS = (Listed("Simulate", "panorama", panorama),)
