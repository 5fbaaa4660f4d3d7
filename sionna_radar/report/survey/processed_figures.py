"""Figures of a processed recording: its spectrum or readings, and its DEM."""

from collections.abc import Callable
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sionna_radar.foundation.decibels import decibels
from sionna_radar.report.colours import BLUE, ERRORS, HEIGHTS, ORANGE, RED
from sionna_radar.report.coordinates import Coordinates, frame_of, map_bounds
from sionna_radar.report.drawing import ReportFigure, colour_bar, finish_map, height_colours, map_size, show_raster
from sionna_radar.report.page.sections import span_of
from sionna_radar.report.survey.figures import draw_beat
from sionna_radar.report.survey.navigation_figure import draw_errors
from sionna_radar.report.terminal import number
from sionna_radar.survey.result import Processed, RangeSpectrum
from sionna_radar.survey.sensors.sweeps import ChirpRecord

# Quantile of |error| beyond which colours saturate.
SATURATED = 0.98
TINY = 1e-300


def figures_of(processed: Processed, coordinates: Coordinates) -> dict[str, Callable[[Processed], Figure]]:
    """Return the drawings of the spectrum or the readings, and of the DEM, if any."""
    figures: dict[str, Callable[[Processed], Figure]] = {}
    figures |= {"readings": draw_readings} if processed.chirp is None else {"spectrum": draw_spectrum}
    if processed.dem is not None and processed.dem.filled.any():
        figures["dem"] = partial(draw_map, coordinates=coordinates)
    if (navigation := processed.navigation) is not None:
        figures["navigation"] = lambda _: draw_errors(navigation, None)
    return figures


def draw_spectrum(processed: Processed) -> Figure:
    """Draw the beat signal of one chirp, and its spectrum with the mean, median, floor and threshold of all."""
    record, spectrum = processed.chirp, processed.spectrum
    assert record is not None
    assert spectrum is not None
    figure = ReportFigure(figsize=(9.0, 7.0), layout="constrained")
    time_axes, range_axes = figure.subplots(2, 1)
    draw_beat(time_axes, record)
    time_axes.set(xlabel="Time in the sweep (ms)", ylabel="Beat signal (as recorded)")
    time_axes.set_title(f"Beat signal of pulse {record.pulse}", fontsize="medium")
    time_axes.legend(frameon=False, ncols=2)
    _draw_powers(range_axes, record, spectrum)
    range_axes.axhline(10 * np.log10(max(spectrum.floor, TINY)), color="black", lw=0.8, ls=":", label="Noise floor")
    range_axes.legend(loc="upper right", framealpha=0.9, ncols=2)
    return figure


def draw_readings(processed: Processed) -> Figure:
    """Draw ranges that were read before against their time."""
    echoes = processed.echoes
    figure = ReportFigure(figsize=(9.0, 4.0), layout="constrained")
    axes = figure.subplots()
    axes.plot(processed.time_s[echoes.pulse], echoes.range_m, color=BLUE, ls="", marker=".", ms=3)
    axes.set(xlabel="Time (s)", ylabel="Range (m)")
    axes.grid(alpha=0.3)
    return figure


def _draw_powers(axes: Axes, record: ChirpRecord, spectrum: RangeSpectrum) -> None:
    axes.plot(record.range_m, decibels(record.power), color=BLUE, lw=0.6, alpha=0.6, label=f"Pulse {record.pulse}")
    axes.plot(record.range_m, decibels(record.threshold), color=ORANGE, lw=1.2, ls="--", label="CFAR threshold")
    axes.plot(spectrum.range_m, decibels(spectrum.mean), color="0.2", lw=1.2, label="Mean of pulses")
    axes.plot(spectrum.range_m, decibels(spectrum.median), color="0.55", lw=1.2, label="Median of pulses")
    label = f"{len(record.echo_range_m)} detected"
    axes.plot(
        record.echo_range_m, decibels(record.echo_power), ls="", marker="v", ms=8, mfc=RED, mec="black", label=label
    )
    axes.set(xlabel="Range, not corrected for Doppler (m)", ylabel="Power (dB of the recording's unit squared)")
    axes.margins(x=0)
    axes.grid(alpha=0.3)


def draw_map(processed: Processed, coordinates: Coordinates = Coordinates.MAP) -> Figure:
    """Draw the DEM, and its error if the truth is known."""
    assert processed.dem is not None
    frame, dem, comparison = frame_of(processed.georeference, coordinates), processed.dem, processed.comparison
    bounds = map_bounds(dem.grid.extent_m, np.zeros((0, 3)))
    width, height = map_size(bounds, (4.2, 5.0))
    figure = ReportFigure(
        figsize=((width + 2.2) * (1 if comparison is None else 2), height + 1.3), layout="constrained"
    )
    axes = np.atleast_1d(figure.subplots(1, 1 if comparison is None else 2))
    limits = span_of(dem.height_m)
    show_raster(axes[0], dem, HEIGHTS, Normalize(*limits))
    finish_map(axes[0], bounds, "DEM", frame)
    colour_bar(axes[0], height_colours(limits, frame), frame.height, width)
    if comparison is not None:
        values = comparison.error.height_m[comparison.error.filled]
        limit = float(np.quantile(np.abs(values), SATURATED)) if len(values) else 1.0
        show_raster(axes[1], comparison.error, ERRORS, Normalize(-limit, limit))
        title = f"Error, RMSE of lit cells {number(comparison.lit_error.rms_m, '.3f', ' m')}"
        finish_map(axes[1], bounds, title, frame)
        colour_bar(axes[1], axes[1].images[0], "DEM minus truth (m)", width, extend="both")
    return figure
