"""Range of an echo within the run of cells it was detected in.

An estimator of one's own is any function of an `EchoRuns`; add it to ESTIMATORS under a name.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, kw_only=True)
class EchoRuns:
    """Runs of spectrum bins, one an echo, and the spectra they lie in.

    power, noise: spectra and noise estimates of the block.
    row: spectrum of each run; start, stop: its bins, stop not included; peak: its strongest bin.
    bin_m: distance between bins.
    """

    power: Float[np.ndarray, "pulse bin"]
    noise: Float[np.ndarray, "pulse bin"]
    row: Int[np.ndarray, " echo"]
    start: Int[np.ndarray, " echo"]
    stop: Int[np.ndarray, " echo"]
    peak: Int[np.ndarray, " echo"]
    bin_m: float

    def cells(self) -> tuple[Int[np.ndarray, " cell"], Int[np.ndarray, " cell"], Int[np.ndarray, " echo"]]:
        """Return row and bin of all cells of all runs, and where each run begins among them."""
        return run_cells(self.row, self.start, self.stop)


def run_cells(
    row: Int[np.ndarray, " run"], start: Int[np.ndarray, " run"], stop: Int[np.ndarray, " run"]
) -> tuple[Int[np.ndarray, " cell"], Int[np.ndarray, " cell"], Int[np.ndarray, " run"]]:
    """Return row and bin of all cells of some runs, and where each run begins among them."""
    length = stop - start
    begin = np.concatenate([[0], np.cumsum(length)[:-1]]).astype(np.int64)
    bins = np.arange(length.sum()) - np.repeat(begin - start, length)
    return np.repeat(row, length), bins, begin


def peak_range(runs: EchoRuns) -> Float[np.ndarray, " echo"]:
    """Return the range of the strongest bin, refined by a parabola through the logarithms of three bins."""
    last = runs.power.shape[1] - 1
    inner = np.clip(runs.peak, 1, last - 1)
    tiny = np.finfo(float).tiny
    left, middle, right = (np.log(runs.power[runs.row, inner + k] + tiny) for k in (-1, 0, 1))
    curvature = left - 2 * middle + right
    curved = (curvature < 0) & (inner == runs.peak)
    step = np.where(curved, 0.5 * (left - right) / np.where(curved, curvature, 1.0), 0.0)
    return (runs.peak + np.clip(step, -1.0, 1.0)) * runs.bin_m


def centroid_range(runs: EchoRuns) -> Float[np.ndarray, " echo"]:
    """Return the mean range of the run, weighted by the power above the noise."""
    if len(runs.row) == 0:
        return np.zeros(0)
    row, bins, begin = runs.cells()
    weight = np.maximum(runs.power[row, bins] - runs.noise[row, bins], 0.0)
    total = np.add.reduceat(weight, begin)
    mean = np.add.reduceat(weight * bins, begin) / np.where(total > 0, total, 1.0)
    return np.where(total > 0, mean, runs.peak) * runs.bin_m


ESTIMATORS: dict[str, Callable[[EchoRuns], Float[np.ndarray, " echo"]]] = {
    "peak": peak_range,
    "centroid": centroid_range,
}
