"""Parts of maps: rasters, axes with a north arrow, colour bars."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation

from sionna_radar.raster import Raster

EMPTY = "0.82"


def show_raster(axes: Axes, raster: Raster, colours: str, scale: Normalize) -> None:
    """Show a raster in its place, empty cells in plain grey."""
    axes.set_facecolor(EMPTY)
    height = np.ma.masked_invalid(raster.height_m)
    # Smoothing would let colours bleed into empty cells.
    axes.imshow(
        height, origin="lower", extent=raster.grid.extent_m, cmap=colours, norm=scale, interpolation="nearest"
    )


def finish_map(axes: Axes, bounds: tuple[float, float, float, float], title: str) -> None:
    """Give a map its limits (west, east, south, north), equal scales, labels and a north arrow."""
    axes.set(xlim=bounds[:2], ylim=bounds[2:], xlabel="East (m)", ylabel="North (m)")
    axes.set_aspect("equal")
    axes.set_title(title, fontsize="medium")
    aspect = (bounds[1] - bounds[0]) / (bounds[3] - bounds[2])
    axes.xaxis.set_major_locator(MaxNLocator(nbins=7 if aspect > 0.7 else 3, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(nbins=7 if aspect < 2 else 4, steps=[1, 2, 5, 10]))
    halo = [withStroke(linewidth=2.5, foreground="white")]
    arrow = {"arrowstyle": "-|>", "lw": 1.5, "path_effects": halo, "shrinkA": 0, "shrinkB": 0}
    # Offsets from the corner, in points, keep the arrow's size whatever the size of the map.
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


def colour_bar(
    axes: Axes, mappable: ScalarMappable, label: str, width_in: float, extend: str = "neither"
) -> None:
    """Put a colour bar beside a map that is so many inches wide."""
    # An inset keeps the height of its map, which the layout engine's own bars do not where scales are equal.
    inset = axes.inset_axes((1 + 0.12 / width_in, 0.0, 0.16 / width_in, 1.0))
    axes.figure.colorbar(mappable, cax=inset, extend=extend, label=label)


def empty_patch() -> Patch:
    """Return the legend entry of empty cells."""
    return Patch(facecolor=EMPTY, edgecolor="0.4", label="No height: shadow or no echo")
