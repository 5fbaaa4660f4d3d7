"""Drawing of maps and figures: shading, colours, coordinates, quantities and files."""

import io
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, MaxNLocator
from matplotlib.transforms import ScaledTranslation

from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.threads import in_background
from sionna_radar.report.colours import EMPTY, HEIGHTS
from sionna_radar.report.coordinates import LOCAL_FRAME, Frame
from sionna_radar.scenario.table import without_unit


class _ShiftedLocator(MaxNLocator):
    """Ticks at round numbers of a shifted axis."""

    def __init__(self, shift: float, nbins: int) -> None:
        super().__init__(nbins=nbins, steps=[1, 2, 5, 10])
        self._shift = shift

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        return [tick - self._shift for tick in super().tick_values(vmin + self._shift, vmax + self._shift)]


def shift_ticks(axis: Axis, shift: float, most: int) -> None:
    """Label an axis with its values plus a shift, at round numbers and without a separate offset."""
    axis.set_major_locator(_ShiftedLocator(shift, most))
    # Round to a micrometre, to hide round-off of the shift.
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{round(value + shift, 6):.12g}"))


BOX_IN = (5.8, 4.8)  # largest width and height of a map on its own


def map_size(bounds: tuple[float, float, float, float], box_in: tuple[float, float] = BOX_IN) -> tuple[float, float]:
    """Return the size in inches of a map that fits the box."""
    width_m, height_m = bounds[1] - bounds[0], bounds[3] - bounds[2]
    scale = min(box_in[0] / width_m, box_in[1] / height_m)
    return width_m * scale, height_m * scale


def show_raster(axes: Axes, raster: Raster, colours: str, scale: Normalize) -> None:
    """Show a raster at its position, empty cells in plain grey."""
    axes.set_facecolor(EMPTY)
    height = np.ma.masked_invalid(raster.height_m)
    # Interpolation would blur colours into empty cells.
    axes.imshow(height, origin="lower", extent=raster.grid.extent_m, cmap=colours, norm=scale, interpolation="nearest")


def head(axes: Axes, title: str) -> None:
    """Write the title above axes that have no ticks and no offset of their labels there."""
    # Without a height matplotlib lays out all ticks again, each time the title is drawn or measured, to find it.
    axes.set_title(title, fontsize="medium", y=1.0)


def finish_map(axes: Axes, bounds: tuple[float, float, float, float], title: str, frame: Frame = LOCAL_FRAME) -> None:
    """Give a map its limits (west, east, south, north; local), equal scales, labels and a north arrow."""
    axes.set(xlim=bounds[:2], ylim=bounds[2:], xlabel=frame.east, ylabel=frame.north)
    axes.set_aspect("equal")
    head(axes, title)
    aspect = (bounds[1] - bounds[0]) / (bounds[3] - bounds[2])
    shift_ticks(axes.xaxis, frame.origin_m[0], frame.most_ticks if aspect > 0.7 else frame.most_ticks // 2)
    shift_ticks(axes.yaxis, frame.origin_m[1], 7 if aspect < 2 else 4)
    halo = [withStroke(linewidth=2.5, foreground="white")]
    arrow = {"arrowstyle": "-|>", "lw": 1.5, "path_effects": halo, "shrinkA": 0, "shrinkB": 0}
    # Offsets from the corner in points: the arrow's size is independent of the map's.
    corner = axes.transAxes + ScaledTranslation(-14 / 72, -8 / 72, axes.figure.dpi_scale_trans)
    axes.annotate(
        "N",
        (1, 1),
        xycoords=corner,
        xytext=(0, -32),
        textcoords="offset points",
        ha="center",
        va="top",
        weight="bold",
        path_effects=halo,
        arrowprops=arrow,
    )


def colour_bar(axes: Axes, mappable: ScalarMappable, label: str, width_in: float, extend: str = "neither") -> None:
    """Put a colour bar beside a map of the given width in inches."""
    # An inset has the height of its map; colour bars of the layout engine do not if axis scales are equal.
    inset = axes.inset_axes((1 + 0.12 / width_in, 0.0, 0.16 / width_in, 1.0))
    bar = axes.figure.colorbar(mappable, cax=inset, extend=extend, label=label)
    # Heights of a mountain: 1203, not 3 with "+1.2e3" above the bar.
    bar.formatter.set_useOffset(False)


def empty_patch(why: str = "shadow or no echo") -> Patch:
    """Return the legend entry of empty cells."""
    return Patch(facecolor=EMPTY, edgecolor="0.4", label=f"No height: {why}")


def height_colours(limits: tuple[float, float], frame: Frame = LOCAL_FRAME) -> ScalarMappable:
    """Return the colours of heights between two limits (local), for a colour bar."""
    low, high = (limit + frame.origin_m[2] for limit in limits)
    return ScalarMappable(Normalize(low, high), HEIGHTS)


def dot_size(map_in: tuple[float, float], count: int) -> float:
    """Return the dot size, in points, at which this many dots leave most of a map visible."""
    return float(np.clip(72 * np.sqrt(map_in[0] * map_in[1] / max(count, 1)) / 8, 0.75, 2.5))


DPI = 150
SCREEN_DPI = 100

Subject = TypeVar("Subject")


class ReportFigure(Figure):
    """A figure outside pyplot: no window, no shared state; displayed in notebooks as in print."""

    def _repr_png_(self) -> bytes:
        return png_of(self, SCREEN_DPI)


def png_of(figure: Figure, dpi: float) -> bytes:
    """Return a figure as PNG, drawn once; it stays as it is."""
    layout, own_dpi, canvas = figure.get_layout_engine(), figure.dpi, figure.canvas
    file = io.BytesIO()
    imsave(file, _drawn(figure, dpi).buffer_rgba(), format="png", origin="upper", dpi=dpi)
    figure.set_layout_engine(layout)
    figure.set_dpi(own_dpi)
    figure.set_canvas(canvas)
    return file.getvalue()


def save_figures(subject: Subject, drawings: Mapping[str, Callable[[Subject], Figure]], directory: Path) -> list[Path]:
    """Draw several figures of a subject, each into `NAME.png` of a directory, and return the files."""
    directory.mkdir(parents=True, exist_ok=True)
    paths = [directory / f"{name}.png" for name in drawings]
    # One is written while the next one is drawn.
    written = [
        in_background(partial(_write, _drawn(draw(subject), DPI), path))
        for path, draw in zip(paths, drawings.values(), strict=True)
    ]
    for finish in written:
        finish()
    return paths


def _drawn(figure: Figure, dpi: int | float) -> FigureCanvasAgg:
    """Return the picture that `figure.savefig` makes, drawn once: it would draw everything twice for the layout."""
    figure.set_dpi(dpi)
    layout = figure.get_layout_engine()
    if layout is not None:
        layout.execute(figure)
        figure.set_layout_engine("none")
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return canvas


def _write(canvas: FigureCanvasAgg, path: Path) -> None:
    # Run lengths alone: two thirds of the time, files longer by a seventh.
    compression = {"compress_type": zlib.Z_RLE}
    imsave(path, canvas.buffer_rgba(), format="png", origin="upper", dpi=DPI, pil_kwargs=compression)


# Key names that need the name of their table.
VAGUE = ("guard", "height", "kind", "material", "method", "mode", "model", "path", "rank", "seed", "training", "window")


def readable(key: str) -> str:
    """Return a dotted key as words with its unit, such as `Beamwidth (deg)`."""
    *tables, name = key.split(".")
    words, unit = without_unit(name)
    if words in VAGUE and tables:
        words = f"{tables[-1]} {words}"
    words = words.replace("_", " ").replace("dem ", "DEM ").replace("cfar", "CFAR").replace("snr", "SNR")
    return words[:1].upper() + words[1:] + (f" ({unit})" if unit else "")


MAX_SHADED_CELLS = 1_000


def shaded(
    raster: Raster, limits: tuple[float, float], colours_name: str = HEIGHTS
) -> Float[np.ndarray, "row column 4"]:
    """Return the colours of heights, lit from the north-west; relief is exaggerated where it is faint."""
    step = max(1, int(np.ceil(max(raster.grid.shape) / MAX_SHADED_CELLS)))
    height = raster.height_m[::step, ::step]
    colours: Float[np.ndarray, "row column 4"]
    colours = colormaps[colours_name].with_extremes(bad=EMPTY)(Normalize(*limits)(np.ma.masked_invalid(height)))
    if min(height.shape) < 2:
        return colours
    north, east = np.gradient(height, raster.grid.spacing_m * step)
    filled = np.isfinite(north) & np.isfinite(east)
    slope = np.sqrt(np.mean((north**2 + east**2)[filled])) if filled.any() else 0.0
    exaggeration = min(0.5 / slope, 10.0) if slope > 0 else 1.0
    toward_light = (exaggeration * (east - north) / np.sqrt(2) + 1.0) / np.sqrt(2)
    light = toward_light / np.sqrt(1 + exaggeration**2 * (north**2 + east**2))
    colours[filled, :3] *= np.clip(0.55 + 0.55 * light[filled], 0.4, 1.0)[:, None]
    return colours
