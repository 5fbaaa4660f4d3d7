"""Command `live`: a flight in real time, with an autopilot in the loop."""

import math
from contextlib import closing, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sionna_radar.cli.session import SCENARIO, Listed, Session, command
from sionna_radar.foundation.errors import ScenarioError

if TYPE_CHECKING:
    from sionna_radar.cli.session import OpenCheckpoints
    from sionna_radar.studies.live.flight import LiveFlight


@command(*SCENARIO)
def live(
    session: Session,
    speed: Annotated[
        float | None,
        typer.Option(metavar="X", min=0.01, max=1000, help="Seconds flown in a second; default: as fast as it goes."),
    ] = None,
    mavlink: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Fly by the poses of an autopilot, such as udp:127.0.0.1:14550, and send it distances and obstacles.",
        ),
    ] = None,
    system: Annotated[
        int | None, typer.Option(min=1, max=255, help="MAVLink number of the vehicle; default: that of the first pose.")
    ] = None,
    sensor_id: Annotated[int, typer.Option(min=0, max=255, help="Number of this radar in DISTANCE_SENSOR.")] = 0,
    origin: Annotated[
        str,
        typer.Option(
            metavar="E,N,U", help="Local east, north and up, m, of the origin of the autopilot's local frame."
        ),
    ] = "0,0,0",
    clearance: Annotated[
        float,
        typer.Option(
            min=0.1, max=1000, help="Echoes this far above or below the vehicle, m, are obstacles in its way."
        ),
    ] = 5.0,
    seconds: Annotated[
        float, typer.Option(min=0.1, help="With --mavlink: end after this time of flight; else with Ctrl-C.")
    ] = float("inf"),
    silence: Annotated[
        float, typer.Option(min=0.1, help="With --mavlink: end after this long without a pose, s; else wait for ever.")
    ] = float("inf"),
    mcap: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write points, readings and the DEM as ROS 2 messages.")
    ] = None,
    rosbag: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Write the same as a rosbag2.")] = None,
) -> None:
    """Fly a scenario or replay a recording live: a map that grows, an autopilot in the loop, messages of ROS 2."""
    from sionna_radar.studies.live.document import DOCUMENT
    from sionna_radar.studies.live.flight import flown_frames, fly_live, open_source
    from sionna_radar.studies.live.mavlink import MavlinkVehicle
    from sionna_radar.studies.live.ros_messages import recorded

    if mavlink is not None and speed is not None:
        raise ScenarioError.of_option(
            "--speed", "has no meaning with --mavlink, whose peer sets the time; leave one out"
        )
    origin_m = _triple(origin)
    of_autopilot = {
        "--system": system is not None,
        "--sensor-id": sensor_id != 0,
        "--origin": origin_m != (0.0, 0.0, 0.0),
        "--clearance": clearance != 5.0,
        "--seconds": seconds != math.inf,
        "--silence": silence != math.inf,
    }
    if mavlink is None and (given := [name for name, is_given in of_autopilot.items() if is_given]):
        raise ScenarioError.of_option(given[0], "has a meaning with --mavlink only; give that, or leave this out")
    files = {path: bag for path, bag in ((mcap, False), (rosbag, True)) if path is not None}

    def fly(_: "OpenCheckpoints") -> "LiveFlight":
        """Fly the source, or the autopilot's way, while messages are recorded into files (True: a rosbag2)."""
        with open_source(session.scenario, session.overrides, session.load) as (source, radar):
            if radar is not None:
                radar.warm_up()
            vehicle = None
            if mavlink is not None:
                if radar is None:
                    message = "needs a scenario, whose radar flies; a recording has flown"
                    raise ScenarioError.of_option("--mavlink", message)
                vehicle = MavlinkVehicle(
                    mavlink, radar, system=system, origin_m=origin_m, clearance_m=clearance, sensor=sensor_id
                )
                source = replace(source, frames=flown_frames(radar, vehicle, flown_s=seconds, silent_s=silence))
            with recorded(files, radar) as recorders, closing(vehicle) if vehicle is not None else nullcontext():
                if vehicle is not None and not session.quiet:
                    typer.echo(f"listening at {mavlink}; Ctrl-C ends the flight", err=True)
                flight = fly_live(
                    source,
                    speed=speed,
                    vehicle=vehicle,
                    listeners=tuple(recorders),
                    status=lambda line: None if session.quiet else typer.echo(line, err=True),
                )
                for recorder in recorders:
                    recorder.finish(flight.dem, flight.sigma)
            return flight

    session.produce(fly, DOCUMENT)


def _triple(text: str) -> tuple[float, float, float]:
    try:
        east, north, up = (float(word) for word in text.split(","))
    except ValueError as error:
        raise ScenarioError.of_option("--origin", f"{text!r} are not three numbers; give east, north and up") from error
    if not math.isfinite(east + north + up):
        raise ScenarioError.of_option("--origin", f"{text!r} are not finite; give east, north and up in metres")
    return east, north, up


COMMANDS = (Listed("Simulate", "live", live),)
