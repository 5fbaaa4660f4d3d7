"""Command `image`: images of side-looking radars."""

from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.cli.session import SCENARIO, Listed, Session, command
from sionna_radar.foundation.errors import ScenarioError


@command(*SCENARIO)
def image(
    session: Session,
    ground_height: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Of a recording: height of the ground on its map, m; default: that of the simulated flight.",
        ),
    ] = None,
) -> None:
    """Write the slant-range image of a side-looking scenario and, with persistent speckle, the focused one.

    In place of the scenario a recording may be given, as for `process`: its pulses are imaged along their measured
    poses.
    """
    from sionna_radar.studies.images.document import DOCUMENT
    from sionna_radar.studies.images.study import Imagery, image_recording
    from sionna_radar.studies.images.study import image as run_images
    from sionna_radar.survey.recordings.described import is_recording

    def imaged() -> Imagery:
        if is_recording(Path(session.scenario)):
            return image_recording(session.scenario, session.overrides, ground_m=ground_height)
        if ground_height is not None:
            raise ScenarioError.of_option("--ground-height", "is of a recording; a scenario has its terrain")
        return run_images(session.load())

    session.produce(lambda _: imaged(), DOCUMENT)


COMMANDS = (Listed("Simulate", "image", image),)
