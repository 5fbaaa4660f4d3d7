"""How well a map with steps is known: within its parts, and beside their borders.

A cell beside a border belongs to the other side with the chance that the border, known to a part of a cell, runs beyond
its centre. Then it is wrong by the whole step: the variance of the cell rises by step^2 p (1 - p).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.stats import norm

from sionna_radar.foundation.raster import Grid

# Standard deviation of a border's place, and how far from it the centres of the cells beside it are, in cells.
BORDER_SIGMA_CELLS, BESIDE_CELLS = 0.5, 0.5


@dataclass(frozen=True)
class SteppedUncertainty:
    """The standard deviations of the cells of a map with steps."""

    cell_sigma_m: Float[np.ndarray, "row column"]

    def sigma_m(self, grid: Grid, wanted: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """Return the standard deviation of the wanted cells; NaN elsewhere. The grid is that of the map."""
        return np.where(wanted, self.cell_sigma_m, np.nan)

    def mean_sigma_m(self, place_m: Float[np.ndarray, "cell 2"], window_m: float) -> float:
        """Return NaN: errors of borders are shared in ways that are not worked out."""
        return float("nan")


def beside_borders(
    sigma_m: Float[np.ndarray, "row column"],
    height_m: Float[np.ndarray, "row column"],
    part: Int[np.ndarray, "row column"],
) -> SteppedUncertainty:
    """Return the uncertainty of a map from that within its parts, their numbers, and its heights."""
    highest, lowest = maximum_filter(height_m, 3, mode="nearest"), minimum_filter(height_m, 3, mode="nearest")
    border = maximum_filter(part, 3, mode="nearest") != minimum_filter(part, 3, mode="nearest")
    step_m = np.where(border, np.maximum(highest - height_m, height_m - lowest), 0.0)
    beyond = float(norm.cdf(-BESIDE_CELLS / BORDER_SIGMA_CELLS))
    return SteppedUncertainty(np.hypot(sigma_m, step_m * np.sqrt(beyond * (1 - beyond))))
