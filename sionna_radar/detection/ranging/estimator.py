"""Range estimator interface: range and uncertainty of an echo from its detected span of bins.

Speckle: bin power is exponentially distributed about the mean echo profile; a window correlates neighbouring bins, so
that a bin counts as `looks_per_bin` independent looks. Every estimator returns the standard deviation of the range.
"""

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.detection.ranging.plane_fit import BeamProfile


@dataclass(frozen=True, kw_only=True)
class EchoSpans:
    """Spans of spectrum bins, one per echo, and the spectra that contain them.

    power, noise: spectra and noise estimates of the block.
    row: spectrum of each span; start, stop: its bins, stop excluded; peak: its strongest bin.
    bin_m: distance between bins.
    looks_per_bin: independent looks per bin.
    beam: the mean echo of a plane across the beam; None if the antenna is unknown.
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
        """Return row and bin of all cells of all spans, and the index of each span's first cell."""
        return span_cells(self.row, self.start, self.stop)

    def rows(self, keep: Bool[np.ndarray, " echo"]) -> "EchoSpans":
        """Return the kept spans."""
        return replace(self, row=self.row[keep], start=self.start[keep], stop=self.stop[keep], peak=self.peak[keep])


@dataclass(frozen=True, kw_only=True)
class Ranges:
    """Echo ranges on the range axis of the spectrum, and their standard deviations."""

    range_m: Float[np.ndarray, " echo"]
    sigma_m: Float[np.ndarray, " echo"]


def span_cells(
    row: Int[np.ndarray, " span"], start: Int[np.ndarray, " span"], stop: Int[np.ndarray, " span"]
) -> tuple[Int[np.ndarray, " cell"], Int[np.ndarray, " cell"], Int[np.ndarray, " span"]]:
    """Return row and bin of all cells of the spans, and the index of each span's first cell."""
    length = stop - start
    begin = (np.cumsum(length) - length).astype(np.int64)
    bins = np.arange(length.sum()) - np.repeat(begin - start, length)
    return np.repeat(row, length), bins, begin


@runtime_checkable
class RangeEstimator(Protocol):
    """Estimates the ranges of echoes."""

    def __call__(self, spans: EchoSpans) -> Ranges:
        """Return the ranges of the echoes, in their order."""
        ...
