"""Stated uncertainty of a stepped surface: which side of a step a cell belongs to."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import (
    maximum_filter,
    minimum_filter,
)
from scipy.spatial import KDTree

from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.stepped.coarse_map import CoarseMap

# Prior odds that a cell belongs to the other side of a step are these lengths (m) over the distance from the step: for
# a cell mapped above that it is of the ground below, and for one mapped below that it is of what stands above. The map
# takes the highest of equal levels, so that it errs upward more often. Fitted to the frequencies of six surveys of San
# Francisco and Florence, as are the decrease with distance and with the margin, which errs by about one neper
# (`docs/theory/uncertainty.md`).
BELOW_M, ABOVE_M = 0.23, 0.13
# Largest distance at which steps are searched, m, and the radii tried, cells; none was found to matter beyond.
FARTHEST_M, DISTANCES_CELLS = 24.0, (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96)
# Radius of the neighbourhood in which the depth of a step is measured: in distances of the step, with a minimum in m.
DEPTH_RADIUS_DISTANCES, MIN_DEPTH_RADIUS_M = 2, 4.0


@dataclass(frozen=True)
class SteppedUncertainty:
    """Standard deviations of the cells of a stepped map.

    other_side: probability that a cell belongs to the other side of a step, and is wrong by the whole step.
    step_sigma_m: contribution of that error; without it remains the standard deviation of cells on the right side.
    """

    cell_sigma_m: Float[np.ndarray, "row column"]
    other_side: Float[np.ndarray, "row column"]
    step_sigma_m: Float[np.ndarray, "row column"]

    def sigma_m(self, grid: Grid, wanted: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """Return the standard deviation of the wanted cells; NaN elsewhere. The grid is that of the map."""
        return np.where(wanted, self.cell_sigma_m, np.nan)

    def mean_sigma_m(self, place_m: Float[np.ndarray, "cell 2"], window_m: float) -> float:
        """Return NaN: correlations of border errors are not modelled."""
        return float("nan")


def sigma_after_reassignment(
    sigma_m: Float[np.ndarray, "row column"],
    before: Int[np.ndarray, "row column"],
    after: Int[np.ndarray, "row column"],
) -> Float[np.ndarray, "row column"]:
    """Return standard deviations in which a cell that changed its region takes that of the nearest cell that did not.

    sigma_m: standard deviations within the regions that the cells belonged to before.
    before, after: numbers of the regions of the cells.
    """
    result, moved = sigma_m.copy(), before != after
    for number in np.unique(after[moved]):
        stayed, came = np.argwhere((after == number) & ~moved), np.argwhere((after == number) & moved)
        if len(stayed):
            nearest = stayed[KDTree(stayed).query(came)[1]]
            result[came[:, 0], came[:, 1]] = sigma_m[nearest[:, 0], nearest[:, 1]]
    return result


def stepped_uncertainty(
    sigma_m: Float[np.ndarray, "row column"],
    height_m: Float[np.ndarray, "row column"],
    coarse: CoarseMap,
    step_m: float,
    spacing_m: float,
) -> SteppedUncertainty:
    """Return the uncertainty of a map: that inside its regions, and that of the sides of steps.

    The other side of a step is as far away as the deepest foot nearby, or as the levels that the echoes leave open.

    sigma_m: standard deviations within the regions.
    height_m: the map.
    coarse: margins of the echoes against other levels, and their distances from its own heights.
    step_m, spacing_m: smallest height difference that counts as a step, and size of the cells.
    """
    moved_m = height_m - coarse.height_m
    away_m, drop_m = nearest_step_below(height_m, step_m, spacing_m)
    down, drop_m = BELOW_M / away_m * np.exp(-(coarse.below**2) / 2), np.maximum(drop_m, coarse.depth_m + moved_m)
    away_m, rise_m = nearest_step_below(-height_m, step_m, spacing_m)
    up, rise_m = ABOVE_M / away_m * np.exp(-(coarse.above**2) / 2), np.maximum(rise_m, coarse.rise_m - moved_m)
    down, up = down / (1 + down + up), up / (1 + down + up)
    step_sigma_m = np.sqrt(down * drop_m**2 + up * rise_m**2 - (up * rise_m - down * drop_m) ** 2)
    return SteppedUncertainty(np.hypot(sigma_m, step_sigma_m), down + up, step_sigma_m)


def nearest_step_below(
    height_m: Float[np.ndarray, "row column"], step_m: float, spacing_m: float
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
    """Return the distance of each cell from the nearest foot of a step below it, and the depth of the step, m.

    The distance is that of the ring of cells, one of `DISTANCES_CELLS`; infinite without such a foot.
    """
    foot = maximum_filter(height_m, 3, mode="nearest") - height_m > step_m
    foot_m = np.where(foot, height_m, np.inf)
    away_m, depth_m = np.full(height_m.shape, np.inf), np.zeros(height_m.shape)
    for cells in DISTANCES_CELLS:
        reach_m = cells * spacing_m
        if cells > 1 and reach_m > FARTHEST_M:
            break
        below_m = height_m - minimum_filter(foot_m, 2 * cells + 1, mode="nearest")
        lower = below_m > step_m
        away_m[lower] = np.minimum(away_m[lower], reach_m)
        around = lower & (reach_m <= np.maximum(DEPTH_RADIUS_DISTANCES * away_m, MIN_DEPTH_RADIUS_M))
        depth_m[around] = below_m[around]
    return away_m, depth_m
