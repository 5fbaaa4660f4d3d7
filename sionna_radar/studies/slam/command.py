"""Command `slam`: way and map of a panoramic radar."""

from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.cli.session import SCENARIO, Listed, Session, command
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import is_file, is_folder, shown

# White noise of a sample of the odometer, m/s, and of the gyroscope, deg/s.
SPEED_SIGMA, YAW_RATE_SIGMA = 0.1, 0.2


@command(*SCENARIO)
def slam(
    session: Session,
    loops: Annotated[
        bool, typer.Option("--loops/--no-loops", help="Look for places that the drive comes back to.")
    ] = True,
    threshold: Annotated[
        float, typer.Option(metavar="DB", min=3.0, max=40.0, help="Of peaks over the mean around them, dB.")
    ] = 10.0,
    surface: Annotated[
        float, typer.Option(metavar="M", min=0.1, max=100.0, help="Size of the small surfaces that are compared, m.")
    ] = 3.5,
    acceleration: Annotated[
        float, typer.Option(metavar="M/S2", min=0.01, max=100.0, help="Typical acceleration of the vehicle, m/s2.")
    ] = 2.0,
    yaw_acceleration: Annotated[
        float, typer.Option(metavar="DEG/S2", min=0.1, max=1000.0, help="Typical change of its yaw rate, deg/s2.")
    ] = 20.0,
    odometry: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|measured",
            help="CSV of time_s and speed_mps, yaw_rate_rad_s or both; or what the navigation system measured.",
        ),
    ] = None,
    speed_sigma: Annotated[
        float, typer.Option(metavar="M/S", min=1e-4, max=10.0, help="White noise of a sample of its speed, m/s.")
    ] = SPEED_SIGMA,
    yaw_rate_sigma: Annotated[
        float,
        typer.Option(metavar="DEG/S", min=1e-4, max=100.0, help="White noise of a sample of its yaw rate."),
    ] = YAW_RATE_SIGMA,
) -> None:
    """Find the way of a panoramic radar, and the map around it, from its images.

    In place of the scenario the panorama.nc of `panorama`, or the folder that holds it, may be given.
    """
    import numpy as np

    from sionna_radar.studies.panorama.polar_images import PolarImages, read_images
    from sionna_radar.studies.panorama.study import panorama
    from sionna_radar.studies.slam.document import DOCUMENT
    from sionna_radar.studies.slam.motion import Motion
    from sionna_radar.studies.slam.odometry import Odometry, measured_odometry, read_odometry
    from sionna_radar.studies.slam.study import Slam, SlamOptions, check_drive
    from sionna_radar.studies.slam.study import slam as run_slam

    recorded = _recorded_images(session)
    if odometry is None and (speed_sigma, yaw_rate_sigma) != (SPEED_SIGMA, YAW_RATE_SIGMA):
        option = "--yaw-rate-sigma" if speed_sigma == SPEED_SIGMA else "--speed-sigma"
        raise ScenarioError.of_option(option, "is of the --odometry, and there is none; give it, or leave this out")
    options = SlamOptions(
        threshold_db=threshold,
        surface_m=surface,
        motion=Motion(acceleration_mps2=acceleration, yaw_acceleration_rad_s2=float(np.deg2rad(yaw_acceleration))),
        loops=loops,
    )
    noise = {"speed_sigma_mps": speed_sigma, "yaw_rate_sigma_rad_s": float(np.deg2rad(yaw_rate_sigma))}
    # A file that is not readable is refused before a drive is simulated.
    driven = None if odometry in (None, "measured") else read_odometry(Path(odometry), **noise)

    def measured(images: PolarImages) -> Odometry | None:
        return measured_odometry(images, **noise) if odometry == "measured" else driven

    def found() -> Slam:
        """Return the way found from recorded images, or from those of a simulated drive."""
        if recorded is not None:
            images = read_images(recorded)
        else:
            # Too few turns, too large surfaces, or odometry of other times, are refused before the drive.
            images = panorama(session.load(), accept=lambda drive: check_drive(drive, options, measured(drive))).images
        return run_slam(images, options, measured(images))

    session.produce(lambda _: found(), DOCUMENT)


def _recorded_images(session: Session) -> Path | None:
    """Return the file of images given in place of a scenario, itself or by its folder; None for a scenario."""
    from sionna_radar.studies.panorama.polar_images import IMAGES

    path = Path(session.scenario)
    if is_folder(path):
        path = path / IMAGES
        if not is_file(path):
            message = f"is a folder without {IMAGES}; give the folder that `sionna-radar panorama` wrote, or a scenario"
            raise InputFileError(f"recording = {shown(path.parent)} {message}")
    if path.suffix != ".nc":
        return None
    if session.overrides:
        key = min(session.overrides)
        message = f"{key!r} is of a scenario, and the images of {path.name} are given; leave it out"
        raise ScenarioError.of_option("--seed" if key == "seed" else "--set", message)
    return path


COMMANDS = (Listed("Simulate", "slam", slam),)
