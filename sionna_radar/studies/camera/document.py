"""Frames of a camera as files, table and film strip."""

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.image import imsave

from sionna_radar.report.drawing import ReportFigure, head
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.studies.camera.study import Film, Frame

# Frames on the strip at most, and its width.
MAX_SHOWN, WIDTH_IN = 4, 12.0


def film_strip(film: Film) -> Figure:
    """Draw frames spread over the flight."""
    shown = film.frames[:: -(-len(film.frames) // MAX_SHOWN)]
    height, width = shown[0].image.shape
    figure = ReportFigure(figsize=(WIDTH_IN, WIDTH_IN / len(shown) * height / width + 0.4), layout="constrained")
    for axes, frame in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
        axes.imshow(frame.image, cmap="gray", vmin=0, vmax=255)
        axes.set_axis_off()
        head(axes, f"{frame.time_s:.1f} s")
    return figure


FRAMES = Columns[Frame](
    [
        Column(key="time_s", heading="time", form=".2f", unit=" s"),
        Column(key="position_m"),
        Column(key="exposure_s", heading="exposure", form=".2g", unit=" s"),
        Column(key="ground", heading="ground", form=".0%", value=lambda frame: frame.ground.mean()),
        Column(key="contrast", heading="contrast", form=".2g"),
        Column(key="noise", heading="noise", form=".2g"),
    ]
)


def camera_numbers(film: Film) -> dict[str, Any]:
    """Return the numbers of `camera.json`."""
    return {
        "extinction_per_m": film.extinction_per_m,
        "frames": FRAMES.numbers(film.frames),
        "warnings": film.warnings,
        "scenario": film.scenario,
    }


def sentences(film: Film) -> list[str]:
    """Return the visibility, and the criterion by which ground shows in noise."""
    return [
        f"contrast falls to 2 % over {film.visibility_m:.3g} m" if film.extinction_per_m > 0 else "clear air",
        "ground shows where its RMS contrast exceeds the noise of a pixel",
    ]


def write_frames(film: Film, folder: Path) -> None:
    """Write the frames, `frames/frame_000.png` and on."""
    (folder / "frames").mkdir()
    for number, frame in enumerate(film.frames):
        imsave(folder / "frames" / f"frame_{number:03d}.png", frame.image, cmap="gray", vmin=0, vmax=255)


DOCUMENT = StudyDocument[Film](
    marker="camera.json",
    suffix="_camera",
    numbers=camera_numbers,
    tables=lambda film: [FRAMES.table("Frames", film.frames)],
    lines=sentences,
    figures=lambda _: {"film_strip": film_strip},
    notebook=["film_strip"],
    files=[write_frames],
)
