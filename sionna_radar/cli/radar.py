"""Commands about the radar: link budget, images and range-Doppler maps."""

from collections.abc import Sequence
from typing import Annotated

import typer

from sionna_radar.cli.session import Session, command_on_a_scenario
from sionna_radar.foundation.errors import Problem, ScenarioError


@command_on_a_scenario()
def link(
    session: Session,
    incidence: Annotated[
        str | None,
        typer.Option("--incidence", metavar="A1,A2,...", help="Incidence angles, degrees."),
    ] = None,
    rain: Annotated[str | None, typer.Option("--rain", metavar="R1,R2,...", help="Rain rates in mm/h.")] = None,
    pulses: Annotated[int, typer.Option(min=100, max=1_000_000, help="Pulses simulated at each range.")] = 3000,
) -> None:
    """Compute the link budget over each material, in closed form and simulated; exit code 1 if they differ."""
    from sionna_radar.report.studies.link import MARKER, print_link, write_link
    from sionna_radar.studies.link import INCIDENCES_DEG, RAINS_MM_PER_H, run_link_budget

    angles, rates = _numbers("--incidence", incidence, INCIDENCES_DEG), _numbers("--rain", rain, RAINS_MM_PER_H)
    checked = session.load()
    session.produce(
        lambda _: run_link_budget(checked, incidences_deg=angles, rains_mm_per_h=rates, pulses=pulses),
        suffix="_link",
        marker=MARKER,
        write=write_link,
        show=print_link,
        exit_code=lambda result: 0 if result.agrees else 1,
    )


def _numbers(option: str, text: str | None, default: Sequence[float]) -> list[float]:
    """Return the numbers of an option, separated by commas."""
    if text is None:
        return list(default)
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        message = f"{text!r} are not numbers; give some, separated by commas"
        raise ScenarioError([Problem(option, message)], "command line") from error


@command_on_a_scenario()
def image(session: Session) -> None:
    """Simulate a side-looking scenario; write its slant-range image and, with persistent speckle, the focused one."""
    from sionna_radar.report.studies.imagery import MARKER, print_image, write_imagery
    from sionna_radar.studies.images import run_images

    checked = session.load()
    session.produce(
        lambda _: run_images(checked),
        suffix="_image",
        marker=MARKER,
        write=write_imagery,
        show=print_image,
    )


@command_on_a_scenario()
def range_doppler(
    session: Session,
    chirps: Annotated[int, typer.Option(min=20, max=65536, help="Chirps of a frame.")] = 64,
    frames: Annotated[int, typer.Option(min=1, max=10_000, help="Number of consecutive frames.")] = 8,
) -> None:
    """Write range-Doppler maps of frames of chirps from the middle of the flight, with their detections."""
    from sionna_radar.report.studies.range_doppler import MARKER, print_frames, write_frames
    from sionna_radar.studies.images import run_frames

    checked = session.load()
    session.produce(
        lambda _: run_frames(checked, chirps=chirps, frames=frames),
        suffix="_range_doppler",
        marker=MARKER,
        write=write_frames,
        show=print_frames,
    )
