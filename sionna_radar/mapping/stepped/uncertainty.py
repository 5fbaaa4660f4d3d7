"""Stated uncertainty of a stepped surface: which side of a step a cell belongs to."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter
from scipy.spatial import KDTree

from sionna_radar.foundation.raster import Grid


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


# Probability that a cell beside a step is of the other side though nothing speaks against it: a wall crosses it, and
# its height is one or the other by where its centre lies, or what is narrower than a footprint is hidden there. Of two
# surveys, of San Francisco and Florence, less the 1 % that rivals and drawn labels state; elsewhere 2 to 8 %, of boxes
# 0.5 %. It falls with the cube of the distance in cells: 0.5 % next to these cells, 0.1 % beyond.
BESIDE_STEP = 0.04


def unseen_steps(
    height_m: Float[np.ndarray, "row column"], open_m: Float[np.ndarray, "row column"], step_m: float
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
    """Return the probability that cells are of the other side of a step unseen, and the mean square of how far off.

    height_m: the map.
    open_m: how far off another height is of cells that are left empty for it; 0 for others.
    step_m: smallest height difference that counts as a step.
    """
    rise_m = maximum_filter(height_m, 3, mode="nearest") - height_m
    drop_m = height_m - minimum_filter(height_m, 3, mode="nearest")
    off_m = np.maximum(np.maximum(rise_m, drop_m), maximum_filter(open_m, 3, mode="nearest"))
    beside = off_m > step_m
    if not beside.any():
        return np.zeros(height_m.shape), np.zeros(height_m.shape)
    away, (row, column) = distance_transform_edt(~beside, return_indices=True)
    chance = BESIDE_STEP / (1 + away) ** 3
    return chance, chance * off_m[row, column] ** 2


def doubt_of_rivals(
    excess_nepers: Float[np.ndarray, " rival"], off_m: Float[np.ndarray, "proposal row column"]
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
    """Return the probability that cells are of the other side as other maps say, and the mean square of how far off.

    That is the probability that two of them, drawn by their weights, both differ. A rival's weight is the mean of
    exp(-d dE) over the unknown factor d by which the model overstates log-likelihoods: 1 / dE.

    excess_nepers: energies dE of the rivals above that of the map, at least one.
    off_m: how far the rivals are off the map, and then a proposal without an energy, which counts as their mean; 0
        within a step.
    """
    weight = np.append(len(excess_nepers) / excess_nepers / np.sum(1 / excess_nepers), 1.0) / len(off_m)
    share = np.tensordot(weight, off_m != 0, 1)
    return share**2, share * np.tensordot(weight, off_m**2, 1)


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
