"""Range estimators: the range of an echo within the run of cells it was detected in, and how far to trust it.

Speckle: the power of a cell is exponential about the echo's mean shape, and a window ties neighbouring cells, so
that a bin counts for `looks_per_bin` independent ones. Every estimator returns a standard deviation with the range.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.detection.ranging.beam_profile import BeamProfile
from sionna_radar.scenario.parts import RANGE_ESTIMATORS
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.scenario.table import Table

Builder = TypeVar("Builder", bound=Callable[..., "RangeEstimator"])


@dataclass(frozen=True, kw_only=True)
class EchoRuns:
    """Runs of spectrum bins, one an echo, and the spectra they lie in.

    power, noise: spectra and noise estimates of the block.
    row: spectrum of each run; start, stop: its bins, stop not included; peak: its strongest bin.
    bin_m: distance between bins.
    looks_per_bin: independent looks that a bin is worth.
    beam: what a thin surface across the beam looks like; None where the antenna is unknown.
    """

    power: Float[np.ndarray, "pulse bin"]
    noise: Float[np.ndarray, "pulse bin"]
    row: Int[np.ndarray, " echo"]
    start: Int[np.ndarray, " echo"]
    stop: Int[np.ndarray, " echo"]
    peak: Int[np.ndarray, " echo"]
    bin_m: float
    looks_per_bin: float = 1.0
    beam: BeamProfile | None = None

    def cells(self) -> tuple[Int[np.ndarray, " cell"], Int[np.ndarray, " cell"], Int[np.ndarray, " echo"]]:
        """Return row and bin of all cells of all runs, and where each run begins among them."""
        return run_cells(self.row, self.start, self.stop)

    def rows(self, keep: Bool[np.ndarray, " echo"]) -> "EchoRuns":
        """Return some of the runs."""
        return replace(self, row=self.row[keep], start=self.start[keep], stop=self.stop[keep], peak=self.peak[keep])


@dataclass(frozen=True, kw_only=True)
class Ranges:
    """Ranges of echoes, on the axis of the spectrum, and their standard deviations."""

    range_m: Float[np.ndarray, " echo"]
    sigma_m: Float[np.ndarray, " echo"]


def run_cells(
    row: Int[np.ndarray, " run"], start: Int[np.ndarray, " run"], stop: Int[np.ndarray, " run"]
) -> tuple[Int[np.ndarray, " cell"], Int[np.ndarray, " cell"], Int[np.ndarray, " run"]]:
    """Return row and bin of all cells of some runs, and where each run begins among them."""
    length = stop - start
    begin = np.concatenate([[0], np.cumsum(length)[:-1]]).astype(np.int64)
    bins = np.arange(length.sum()) - np.repeat(begin - start, length)
    return np.repeat(row, length), bins, begin


@runtime_checkable
class RangeEstimator(Protocol):
    """Finds the ranges of echoes."""

    def __call__(self, runs: EchoRuns) -> Ranges:
        """Return the ranges of some echoes, in their order."""
        ...


def register_range_estimator(name: str, parameters: type[Table] | None = None) -> Callable[[Builder], Builder]:
    """Register a range estimator, for `processing.ranging` in a scenario.

    Parameters
    ----------
    name:
        What scenarios call it.
    parameters:
        Its table of parameters, `[processing.ranging_parameters]`; without it there are none.

    Returns
    -------
    A decorator of what builds a `RangeEstimator`: a class or a function, called with the parameters if there are any.

    Raises
    ------
    PluginError
        The name is taken, or the parameters are not a `Table`.

    Examples
    --------
    >>> from sionna_radar.detection import Ranges
    >>> @register_range_estimator("nearest_bin")
    ... class NearestBin:
    ...     def __call__(self, runs):
    ...         return Ranges(range_m=runs.start * runs.bin_m, sigma_m=0.0 * runs.start + runs.bin_m)
    >>> load_scenario("hills", {"processing.ranging": "nearest_bin"}).processing.ranging
    'nearest_bin'

    """
    return RANGE_ESTIMATORS.register(name, parameters)


def build_range_estimator(table: ProcessingTable) -> RangeEstimator:
    """Return the range estimator of a scenario."""
    estimator: RangeEstimator = RANGE_ESTIMATORS.entry(table.ranging)(table.ranging_parameters)
    return estimator
