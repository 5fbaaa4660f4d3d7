"""Range-Doppler maps as files, table and figures."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sionna_radar.foundation.decibels import decibels
from sionna_radar.report.colours import ORANGE, RED
from sionna_radar.report.drawing import ReportFigure
from sionna_radar.report.files.contents import csv_text
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.studies.range_doppler.movers import StaggeredRangeDoppler, wrapped
from sionna_radar.studies.range_doppler.study import Frames, SeenTarget

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
    if frames.targets:
        place = np.array([[target.read_m, target.range_rate_mps] for target in frames.targets])
        rate_mps = wrapped(place[:, 1], float(np.diff(last.range_rate_mps[:2])[0]) * len(last.range_rate_mps))
        axes.plot(place[:, 0], rate_mps, "o", mfc="none", color=RED, ms=11, label="Target")
    folded = ", folded" if isinstance(frames.analyser, StaggeredRangeDoppler) else ""
    axes.set(
        xlabel="Range as read (m)",
        ylabel=f"Range rate{folded} (m/s)",
        title=f"Frame of {frames.analyser.chirps} chirps",
    )
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure


COLUMNS = ("range_m", "range_rate_mps", "power")
MEANING = (
    "Ranges are free of the shift that motion gives a sweep; range rates are positive when receding and wrap "
    "beyond highest_rate_mps. `targets` are those of the scenario in the last frame, with the peak nearest to each, if "
    "one is within a cell; read_m is the range with the shift of the range rate before it wraps. smear_cells is the "
    "change of still ground's range rate during a frame, in cells."
)


def frames_numbers(frames: Frames) -> dict[str, Any]:
    """Return the numbers."""
    analyser = frames.analyser
    return {
        "chirps": analyser.chirps,
        "frames": frames.frames,
        "range_cell_m": analyser.chirp.range_resolution_m,
        "rate_cell_mps": analyser.rate_cell_mps,
        "highest_rate_mps": analyser.highest_rate_mps,
        "noise_loss_db": analyser.noise_loss_db,
        "straddling_loss_db": analyser.straddling_loss_db,
        "smear_cells": frames.smear_cells,
        "detected_share": frames.detected.mean(),
        "changed_share": frames.changed.mean(),
        "meaning": MEANING,
        "targets": frames.targets,
        "scenario": frames.scenario,
    }


def peaks_csv(frames: Frames) -> str:
    """Return the peaks as a table, the strongest first."""
    rows = zip(*(getattr(frames.movers, name) for name in COLUMNS), strict=True)
    return csv_text(COLUMNS, ([f"{value:.6g}" for value in row] for row in rows))


def sentences(frames: Frames) -> list[str]:
    """Return cell sizes, window losses and detected fractions."""
    analyser = frames.analyser
    ring = "ordered-statistic" if frames.scenario.processing.cfar.kind == "OS" else "cell-averaging"
    return [
        f"{frames.frames} frames of {analyser.chirps} chirps: cells of {frames.last.chirp.range_resolution_m:.3g} m "
        f"and {analyser.rate_cell_mps:.3g} m/s, range rates up to {analyser.highest_rate_mps:.3g} m/s",
        f"window: {analyser.noise_loss_db:.1f} dB processing loss, "
        f"{analyser.straddling_loss_db:.1f} dB scalloping loss",
        f"stationary clutter migrates {frames.smear_cells:.2g} Doppler cells per frame",
        f"detected: {frames.detected.mean():.3%} of the cells by {ring} CFAR, {frames.changed.mean():.3%} "
        f"by clutter map; {len(frames.movers)} peaks",
    ]


TARGETS = Columns[SeenTarget](
    [
        Column(key="number", heading="target", form="d"),
        Column(key="range_m", heading="range\nm", form=".3f"),
        Column(key="found_range_m", heading="found\nm", form=".3f"),
        Column(key="range_rate_mps", heading="range rate\nm/s", form=".4f"),
        Column(key="found_rate_mps", heading="found\nm/s", form=".4f"),
    ]
)
DOCUMENT = StudyDocument[Frames](
    marker="range_doppler.json",
    suffix="_range_doppler",
    numbers=frames_numbers,
    opening=sentences,
    tables=lambda frames: [TARGETS.table("Targets in the last frame", frames.targets)] if frames.targets else [],
    figures=lambda _: {"range_doppler": range_doppler},
    notebook=["range_doppler"],
    texts={"peaks.csv": peaks_csv},
)
