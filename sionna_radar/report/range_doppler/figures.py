"""Figures of range-Doppler maps."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sionna_radar.foundation.decibel import decibels
from sionna_radar.report.colours import ORANGE, RED
from sionna_radar.report.figure_files import ReportFigure, save_figures
from sionna_radar.studies.range_doppler import Frames

# Below the strongest cell, dB.
SHOWN_DB = 60.0
# Of ranges beside those with an echo.
MARGIN_M = 2.0


def draw_all(frames: Frames, directory: Path) -> list[Path]:
    """Draw every figure into a directory as PNG, and return the files."""
    return save_figures(frames, {"range_doppler": range_doppler}, directory)


def range_doppler(frames: Frames) -> Figure:
    """Draw the map of the last frame with what is detected in it, and the targets of the scenario."""
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
    axes.plot(last.range_m[bin_], last.range_rate_mps[row], ".", ms=2, color=ORANGE, label="Detected")
    reading_m = last.chirp.doppler_range_m(np.array([target.range_rate_mps for target in frames.targets]))
    if frames.targets:
        place = np.array([[target.range_m, target.range_rate_mps] for target in frames.targets])
        axes.plot(place[:, 0] + reading_m, place[:, 1], "o", mfc="none", color=RED, ms=11, label="Target")
    axes.set(xlabel="Range as read (m)", ylabel="Range rate (m/s)", title=f"Frame of {frames.analyser.chirps} chirps")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return figure
