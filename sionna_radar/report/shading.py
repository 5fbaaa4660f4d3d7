"""Heights in colours, shaded as a relief."""

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.colors import Normalize

from sionna_radar.foundation.raster import Raster
from sionna_radar.report.colours import EMPTY, HEIGHTS

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
