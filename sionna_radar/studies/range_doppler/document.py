"""Range-Doppler maps as files, table and figures."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from sionna_radar.foundation.numerics import decibels
from sionna_radar.report.drawing import ORANGE, RED, ReportFigure
from sionna_radar.report.files.contents import csv_text, without_nan
from sionna_radar.report.files.folder import write_study
from sionna_radar.report.terminal import console, number, say, table_of
from sionna_radar.studies.range_doppler.study import Frames

# Shown dynamic range below the strongest cell, dB.
SHOWN_DB = 60.0
# Margin of range beside the cells with an echo.
MARGIN_M = 2.0


def range_doppler(frames: Frames) -> Figure:
    """Draw the last frame's map, its detections, and the targets at their apparent range."""
    figure = ReportFigure(figsize=(9.0, 5.6), layout="constrained")
    axes = figure.subplots()
    last = frames.last
    power_db = decibels(last.power.ravel()).reshape(last.power.shape)
    top = float(power_db.max())
    shown = axes.pcolormesh(
        last.range_m, last.range_rate_mps, power_db, vmin=top - SHOWN_DB, vmax=top, cmap="viridis", rasterized=True
    )
    lit = last.range_m[(power_db > top - SHOWN_DB).any(axis=0)]
    axes.set_xlim(lit.min() - MARGIN_M, lit.max() + MARGIN_M)
    figure.colorbar(shown, ax=axes, label="Power (dB)")
    row, bin_ = np.nonzero(frames.detected)
    axes.plot(
        last.range_m[bin_], last.range_rate_mps[row], "o", ms=4, mfc=ORANGE, mec="black", mew=0.4, label="Detected"
    )
    reading_m = last.chirp.doppler_range_m(np.array([target.range_rate_mps for target in frames.targets]))
    if frames.targets:
        place = np.array([[target.range_m, target.range_rate_mps] for target in frames.targets])
        axes.plot(place[:, 0] + reading_m, place[:, 1], "o", mfc="none", color=RED, ms=11, label="Target")
    axes.set(xlabel="Range as read (m)", ylabel="Range rate (m/s)", title=f"Frame of {frames.analyser.chirps} chirps")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure


MARKER = "range_doppler.json"
COLUMNS = ("range_m", "range_rate_mps", "power")
MEANING = (
    "Ranges are free of the shift that motion gives a sweep; range rates are positive when receding and wrap "
    "beyond highest_rate_mps. `targets` are those of the scenario in the last frame, with the peak nearest to each, if "
    "one is within a cell. smear_cells is the change of still ground's range rate during a frame, in cells."
)


def write_frames(frames: Frames, directory: Path) -> list[Path]:
    """Write `range_doppler.json`, `peaks.csv` and the figure, and return the files; OutputError as `write_folder`."""
    figures, texts = {"range_doppler": range_doppler}, {"peaks.csv": peaks_csv(frames)}
    return write_study(directory, MARKER, frames, frames_summary(frames), figures, texts)


def frames_summary(frames: Frames) -> dict[str, Any]:
    """Return the numbers in strict JSON form; undefined ones are None."""
    analyser = frames.analyser
    document = {
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
    rows = zip(*(getattr(frames.movers, name) for name in COLUMNS), strict=True)
    return csv_text(COLUMNS, ([f"{value:.6g}" for value in row] for row in rows))


def print_frames(frames: Frames) -> None:
    """Print cell sizes, window losses and detected shares, and the table of targets."""
    analyser = frames.analyser
    say(
        f"{frames.frames} frames of {analyser.chirps} chirps: cells of {frames.last.chirp.range_resolution_m:.3g} m "
        f"and {analyser.rate_cell_mps:.3g} m/s, range rates up to {analyser.highest_rate_mps:.3g} m/s",
        f"windows: {analyser.noise_loss_db:.2f} dB against noise, at worst {analyser.straddling_loss_db:.2f} dB "
        "between cells",
        f"still ground in the beam changes by {frames.smear_cells:.2g} cells of range rate during a frame",
        f"detected: {frames.detected.mean():.3%} of the cells against their CFAR ring, {frames.changed.mean():.3%} "
        f"against earlier frames; {len(frames.movers)} peaks",
    )
    if frames.targets:
        console().print(targets_table(frames))


def targets_table(frames: Frames) -> Table:
    """Return the table of targets and the peak nearest to each, if any: range, m, and range rate, m/s."""
    rows = (
        [
            str(target.number),
            f"{target.range_m:.3f}",
            number(target.found_range_m, ".3f"),
            f"{target.range_rate_mps:.4f}",
            number(target.found_rate_mps, ".4f"),
        ]
        for target in frames.targets
    )
    columns = "target", "range\nm", "found\nm", "range rate\nm/s", "found\nm/s"
    return table_of("Targets in the last frame", columns, rows)
