"""The folder of range-Doppler maps."""

import csv
import io
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from sionna_radar.report.folder import without_nan, write_study
from sionna_radar.report.range_doppler.figures import draw_all
from sionna_radar.studies.range_doppler import Frames

MARKER = "range_doppler.json"
COLUMNS = ("range_m", "range_rate_mps", "power")
MEANING = (
    "Ranges are free of the shift that motion gives a sweep; range rates are positive when receding and wrap "
    "beyond highest_rate_mps. `targets` are those of the scenario in the last frame, with the peak nearest to each, if "
    "one is within a cell. smear_cells is the change of still ground's range rate during a frame, in cells."
)


def write_frames(frames: Frames, directory: Path) -> list[Path]:
    """Write `range_doppler.json`, `peaks.csv` and the figure into a directory, all or nothing, and return the files.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written; see `write_folder`.

    """
    return write_study(
        directory, MARKER, frames_summary(frames), partial(draw_all, frames), {"peaks.csv": peaks_csv(frames)}
    )


def frames_summary(frames: Frames) -> dict[str, Any]:
    """Return the numbers in strict JSON form; a number that does not exist is None."""
    analyser = frames.analyser
    document: dict[str, Any] = {
        "chirps": analyser.chirps,
        "frames": frames.frames,
        "range_cell_m": analyser.chirp.range_resolution_m,
        "rate_cell_mps": analyser.rate_cell_mps,
        "highest_rate_mps": analyser.highest_rate_mps,
        "noise_loss_db": analyser.noise_loss_db,
        "straddling_loss_db": analyser.straddling_loss_db,
        "smear_cells": frames.smear_cells,
        "detected_share": float(frames.detected.mean()),
        "changed_share": float(frames.changed.mean()),
        "meaning": MEANING,
        "targets": [asdict(target) for target in frames.targets],
        "scenario": frames.scenario.model_dump(mode="json"),
    }
    return without_nan(document)


def peaks_csv(frames: Frames) -> str:
    """Return the peaks as a table, the strongest first."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    movers = frames.movers
    for row in zip(movers.range_m, movers.range_rate_mps, movers.power, strict=True):
        rows.writerow([f"{value:.6g}" for value in row])
    return text.getvalue()
