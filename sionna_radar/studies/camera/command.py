"""Command `camera`: frames of a camera along the flight of a scenario."""

from sionna_radar.cli.session import SCENARIO, Listed, Session, command


@command(*SCENARIO)
def camera(session: Session) -> None:
    """Show what a camera sees along the flight: frames by sun or at night, through fog, rain, dust and smoke."""
    from sionna_radar.studies.camera.document import DOCUMENT
    from sionna_radar.studies.camera.study import camera as run_camera

    checked = session.load()
    session.produce(lambda _: run_camera(checked), DOCUMENT)


COMMANDS = (Listed("Simulate", "camera", camera),)
