"""How well a map with steps is known: within its parts, and beside their borders.

A cell beside a border belongs to the other side with a chance p that falls with the margin by which its part is
likelier than the next. Then it is wrong by the whole step: the variance of the cell rises by step^2 p (1 - p).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial import KDTree

from sionna_radar.foundation.raster import Grid

# Margin over which the chance of the other side falls by e. The columns of the model are not the walls of the world,
# and echoes of overlapping pulses are not independent, so that it takes more than one neper.
NEPERS = 16.0


@dataclass(frozen=True)
class SteppedUncertainty:
    """The standard deviations of the cells of a map with steps.

    other_side: probability that a cell is of the part beyond its border, and wrong by the whole step.
    """

    cell_sigma_m: Float[np.ndarray, "row column"]
    other_side: Float[np.ndarray, "row column"]

    def sigma_m(self, grid: Grid, wanted: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """Return the standard deviation of the wanted cells; NaN elsewhere. The grid is that of the map."""
        return np.where(wanted, self.cell_sigma_m, np.nan)

    def mean_sigma_m(self, place_m: Float[np.ndarray, "cell 2"], window_m: float) -> float:
        """Return NaN: errors of borders are shared in ways that are not worked out."""
        return float("nan")


def moved_with(
    sigma_m: Float[np.ndarray, "row column"],
    before: Int[np.ndarray, "row column"],
    after: Int[np.ndarray, "row column"],
) -> Float[np.ndarray, "row column"]:
    """Return standard deviations with those of cells that changed their part taken from the nearest cell that did not.

    Parameters
    ----------
    sigma_m:
        Standard deviations within the parts that the cells belonged to before.
    before, after:
        Numbers of the parts of the cells.

    """
    result, moved = sigma_m.copy(), before != after
    for number in np.unique(after[moved]):
        stayed, came = np.argwhere((after == number) & ~moved), np.argwhere((after == number) & moved)
        if len(stayed):
            nearest = stayed[KDTree(stayed).query(came)[1]]
            result[came[:, 0], came[:, 1]] = sigma_m[nearest[:, 0], nearest[:, 1]]
    return result


def with_steps(
    sigma_m: Float[np.ndarray, "row column"],
    height_m: Float[np.ndarray, "row column"],
    margin: Float[np.ndarray, "row column"],
) -> SteppedUncertainty:
    """Return the uncertainty of a map from that within its parts, its heights, and the margins beside its borders.

    Parameters
    ----------
    sigma_m:
        Standard deviations within the parts.
    height_m:
        The map.
    margin:
        By how many nepers the part of each cell is likelier than the next; infinite away from borders.

    """
    highest, lowest = maximum_filter(height_m, 3, mode="nearest"), minimum_filter(height_m, 3, mode="nearest")
    step_m = np.maximum(highest - height_m, height_m - lowest)
    beyond = 0.5 * np.exp(-margin / NEPERS)
    return SteppedUncertainty(np.hypot(sigma_m, step_m * np.sqrt(beyond * (1 - beyond))), beyond)
