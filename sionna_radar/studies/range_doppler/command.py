"""Command `range-doppler`: maps of frames of chirps."""

from typing import Annotated

import typer

from sionna_radar.cli.session import SCENARIO, Listed, Session, command


@command(*SCENARIO)
def range_doppler(
    session: Session,
    chirps: Annotated[int, typer.Option(min=20, max=65536, help="Chirps of a frame.")] = 64,
    frames: Annotated[int, typer.Option(min=1, max=10_000, help="Number of consecutive frames.")] = 8,
) -> None:
    """Write range-Doppler maps of frames of chirps from the middle of the flight, with their detections."""
    from sionna_radar.studies.range_doppler.document import DOCUMENT
    from sionna_radar.studies.range_doppler.study import range_doppler as run_frames

    checked = session.load()
    session.produce(lambda _: run_frames(checked, chirps=chirps, frames=frames), DOCUMENT)


COMMANDS = (Listed("Simulate", "range-doppler", range_doppler),)
