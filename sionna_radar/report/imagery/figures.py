"""Figures of a side-looking survey's images, for print, in the style of the survey's figures."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from sionna_radar.imaging.sar import SarImage
from sionna_radar.imaging.slar import to_ground
from sionna_radar.report.figure_files import ReportFigure
from sionna_radar.studies.images import Imagery

DPI = 150
COLOURS = "viridis"
EMPTY = "0.82"
WIDTH_IN = 8.0
# Height of an image: that of equal axis scales, within these limits.
HEIGHTS_IN = (1.8, 4.0)
# Decibels around the median: speckle below, buildings and targets above, up to the level few pixels exceed (per cent).
DARKEST_DB, LEAST_BRIGHTEST_DB, BRIGHTEST_SHARE = -12.0, 8.0, 1.0
LABEL = "Power over the median (dB)"


def draw_all(imagery: Imagery, directory: Path) -> list[Path]:
    """Draw every figure into a directory as PNG, and return the files."""
    figures = {"slar": slant_range(imagery)}
    if imagery.focused is not None:
        figures["sar"] = focused(imagery, imagery.focused)
    directory.mkdir(parents=True, exist_ok=True)
    paths = [directory / f"{name}.png" for name in figures]
    for path, figure in zip(paths, figures.values(), strict=True):
        figure.savefig(path, dpi=DPI)
    return paths


def slant_range(imagery: Imagery) -> Figure:
    """Draw the slant-range image, as far as the beam illuminates the ground."""
    strip, image = imagery.strip, imagery.slant
    edges = [strip.slant_range_m(ground) for ground in (strip.near_m, strip.far_m)]
    shown = (image.range_m >= edges[0]) & (image.range_m <= edges[1])
    height = _height_in(image.along_m, image.range_m[shown])
    figure = ReportFigure(figsize=(WIDTH_IN, height + 1.2), layout="constrained")
    axes = figure.subplots()
    level = _level_db(image.power[:, shown].T)
    picture = _show(axes, level, image.along_m, image.range_m[shown], _brightest_db(level))
    title = f"Real aperture (SLAR): resolves {_length(imagery.slar.along_m)} along the track, "
    axes.set_title(f"{title}{_length(imagery.slar.across_m)} in slant range", fontsize="medium")
    axes.set(xlabel="Along the track (m)", ylabel="Slant range (m)")
    figure.colorbar(picture, ax=axes, label=LABEL, extend="both")
    return figure


def focused(imagery: Imagery, image: SarImage) -> Figure:
    """Draw the real-aperture image on level ground, above the focused one of the same pulses."""
    grid = image.grid
    real = to_ground(imagery.slant, imagery.strip.height_m, grid.across_m)
    height = _height_in(grid.along_m, grid.across_m)
    figure = ReportFigure(figsize=(WIDTH_IN, 2 * height + 1.8), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
    levels = _level_db(real.power.T), _level_db(image.power)
    brightest = max(_brightest_db(level) for level in levels)
    _show(upper, levels[0], real.along_m, grid.across_m, brightest)
    picture = _show(lower, levels[1], grid.along_m, grid.across_m, brightest)
    sar = imagery.sar
    resolution = f": resolves {_length(sar.along_m)} along the track, {_length(sar.across_m)} across it" if sar else ""
    titles = (
        f"Real aperture (SLAR): resolves {_length(imagery.slar.along_m)} along the track",
        f"The same pulses focused (SAR){resolution}",
    )
    for axes, title in zip((upper, lower), titles, strict=True):
        axes.set_title(title, fontsize="medium")
    lower.set(xlabel="Along the track (m)", xlim=(grid.along_m[0], grid.along_m[-1]))
    for axes in (upper, lower):
        axes.set_ylabel("Ground range (m)")
    figure.colorbar(picture, ax=(upper, lower), label=LABEL, extend="both")
    return figure


def _level_db(power: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
    """Return power over its median in decibels; NaN where there is none."""
    known = np.where(power > 0, power, np.nan)
    return 10 * np.log10(known / np.nanmedian(known))


def _brightest_db(level: Float[np.ndarray, "row column"]) -> float:
    return max(float(np.nanpercentile(level, 100 - BRIGHTEST_SHARE)), LEAST_BRIGHTEST_DB)


def _show(
    axes: Axes,
    level: Float[np.ndarray, "row column"],
    along_m: Float[np.ndarray, " column"],
    across_m: Float[np.ndarray, " row"],
    brightest_db: float,
) -> AxesImage:
    axes.set_facecolor(EMPTY)
    return axes.imshow(
        np.ma.masked_invalid(level),
        origin="lower",
        extent=(*_outline(along_m), *_outline(across_m)),
        cmap=COLOURS,
        vmin=DARKEST_DB,
        vmax=brightest_db,
        aspect="auto",
        interpolation="nearest",
    )


def _outline(centres: Float[np.ndarray, " n"]) -> tuple[float, float]:
    half = float(centres[1] - centres[0]) / 2
    return float(centres[0]) - half, float(centres[-1]) + half


def _height_in(along_m: np.ndarray, across_m: np.ndarray) -> float:
    scale = (WIDTH_IN - 2.0) / (along_m[-1] - along_m[0])
    return float(np.clip(scale * (across_m[-1] - across_m[0]), *HEIGHTS_IN))


def _length(metres: float) -> str:
    return f"{metres:.2g} m" if metres >= 0.995 else f"{100 * metres:.2g} cm"
