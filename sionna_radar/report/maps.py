"""Parts of maps: their size and bounds, rasters, axes with a north arrow, colours and their bars."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.transforms import ScaledTranslation

from sionna_radar.foundation.raster import Raster
from sionna_radar.report.colours import EMPTY, HEIGHTS
from sionna_radar.report.coordinates import LOCAL_FRAME, Frame, shift_ticks

BOX_IN = (5.8, 4.8)  # largest width and height of a map on its own
MAX_ASPECT = 3.0


def map_size(bounds: tuple[float, float, float, float], box_in: tuple[float, float] = BOX_IN) -> tuple[float, float]:
    """Return the size in inches of a map that fits the box."""
    width_m, height_m = bounds[1] - bounds[0], bounds[3] - bounds[2]
    scale = min(box_in[0] / width_m, box_in[1] / height_m)
    return width_m * scale, height_m * scale


def map_bounds(
    extent_m: tuple[float, float, float, float], position_m: Float[np.ndarray, "n 3"]
) -> tuple[float, float, float, float]:
    """Return the edges (west, east, south, north) of a map of a grid and some positions."""
    west, east, south, north = extent_m
    if len(position_m):
        pad = 0.03 * max(east - west, north - south)
        low, high = position_m.min(axis=0) - pad, position_m.max(axis=0) + pad
        west, east = min(west, low[0]), max(east, high[0])
        south, north = min(south, low[1]), max(north, high[1])
    # A narrow strip gets room at its sides, for the ticks and the colour bar.
    shortest = max(east - west, north - south) / MAX_ASPECT
    across, along = max(0.0, shortest - (east - west)) / 2, max(0.0, shortest - (north - south)) / 2
    return float(west - across), float(east + across), float(south - along), float(north + along)


def show_raster(axes: Axes, raster: Raster, colours: str, scale: Normalize) -> None:
    """Show a raster at its position, empty cells in plain grey."""
    axes.set_facecolor(EMPTY)
    height = np.ma.masked_invalid(raster.height_m)
    # Smoothing would let colours bleed into empty cells.
    axes.imshow(height, origin="lower", extent=raster.grid.extent_m, cmap=colours, norm=scale, interpolation="nearest")


def finish_map(axes: Axes, bounds: tuple[float, float, float, float], title: str, frame: Frame = LOCAL_FRAME) -> None:
    """Give a map its limits (west, east, south, north; local), equal scales, labels and a north arrow."""
    axes.set(xlim=bounds[:2], ylim=bounds[2:], xlabel=frame.east, ylabel=frame.north)
    axes.set_aspect("equal")
    axes.set_title(title, fontsize="medium")
    aspect = (bounds[1] - bounds[0]) / (bounds[3] - bounds[2])
    shift_ticks(axes.xaxis, frame.origin_m[0], frame.most_ticks if aspect > 0.7 else frame.most_ticks // 2)
    shift_ticks(axes.yaxis, frame.origin_m[1], 7 if aspect < 2 else 4)
    halo = [withStroke(linewidth=2.5, foreground="white")]
    arrow = {"arrowstyle": "-|>", "lw": 1.5, "path_effects": halo, "shrinkA": 0, "shrinkB": 0}
    # Offsets from the corner are in points, so that the arrow's size does not depend on that of the map.
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
    # An inset keeps the height of its map; colour bars of the layout engine do not if axis scales are equal.
    inset = axes.inset_axes((1 + 0.12 / width_in, 0.0, 0.16 / width_in, 1.0))
    bar = axes.figure.colorbar(mappable, cax=inset, extend=extend, label=label)
    # Heights of a mountain: 1203, not 3 with "+1.2e3" above the bar.
    bar.formatter.set_useOffset(False)


def empty_patch(why: str = "shadow or no echo") -> Patch:
    """Return the legend entry of empty cells."""
    return Patch(facecolor=EMPTY, edgecolor="0.4", label=f"No height: {why}")


def height_limits(*rasters: Raster) -> tuple[float, float]:
    """Return the lowest and the highest of all heights, in metres, with a minimum difference."""
    heights = np.concatenate([r.height_m[r.filled] for r in rasters])
    if len(heights) == 0:
        return 0.0, 1.0
    low, high = float(heights.min()), float(heights.max())
    # A level surface also needs a scale.
    return (low, high) if high - low > 1e-3 else (low - 0.5, low + 0.5)


def height_colours(limits: tuple[float, float], frame: Frame = LOCAL_FRAME) -> ScalarMappable:
    """Return the colours of heights between two limits (local), for a colour bar."""
    low, high = (limit + frame.origin_m[2] for limit in limits)
    return ScalarMappable(Normalize(low, high), HEIGHTS)


def dot_size(map_in: tuple[float, float], count: int) -> float:
    """Return the size of a dot, in points, at which this many leave most of a map visible."""
    return float(np.clip(72 * np.sqrt(map_in[0] * map_in[1] / max(count, 1)) / 8, 0.75, 2.5))
