"""Range of an echo within the run of cells it was detected in, and how far to trust it.

Speckle: the power of a cell is exponential about the echo's mean shape, and a window ties neighbouring cells, so
that a bin counts for `looks_per_bin` independent ones. Every estimator returns a standard deviation with the range.

A custom estimator is any function of an `EchoRuns` that returns `Ranges`; add it to ESTIMATORS under a name.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.detection.ranging.beam_profile import BeamProfile, fit_echo

# The leading edge is where the echo first reaches this share of its level.
EDGE_SHARE = 0.5
# From there to the middle of a Gaussian echo, over the length of its box: the box of exp(-x^2 / 2 s^2) is 2 sqrt(pi) s
# long and 1 / sqrt(2) high, and half of that is reached sqrt(3 log 2) s before the middle.
EDGE_TO_MIDDLE = float(np.sqrt(3 * np.log(2)) / (2 * np.sqrt(np.pi)))


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

    def only(self, keep: Bool[np.ndarray, " echo"]) -> "EchoRuns":
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


def peak_range(runs: EchoRuns) -> Ranges:
    """Return the range of the strongest bin, refined by a parabola through the logarithms of three bins.

    Under speckle any bin of the echo may be the strongest, so the echo's own width is the uncertainty.
    """
    last = runs.power.shape[1] - 1
    inner = np.clip(runs.peak, 1, last - 1)
    tiny = np.finfo(float).tiny
    left, middle, right = (np.log(runs.power[runs.row, inner + k] + tiny) for k in (-1, 0, 1))
    curvature = left - 2 * middle + right
    curved = curvature < 0
    step = np.where(curved, 0.5 * (left - right) / np.where(curved, curvature, 1.0), 0.0)
    shape = _shape(runs)
    return Ranges(range_m=(inner + np.clip(step, -1.0, 1.0)) * runs.bin_m, sigma_m=shape.width * runs.bin_m)


def centroid_range(runs: EchoRuns) -> Ranges:
    """Return the mean range of the run, weighted by the power above the noise.

    With exponential powers of means mu the variance of sum(P r) / sum(P) is sum(mu^2 (r - mean)^2) / sum(mu)^2
    over independent bins; P^2 / 2 is an unbiased estimate of mu^2.
    """
    shape = _shape(runs)
    return Ranges(range_m=shape.centre * runs.bin_m, sigma_m=shape.speckle * runs.bin_m)


def leading_edge_range(runs: EchoRuns) -> Ranges:
    """Return where the echo first reaches half of its level, moved to its middle by its length.

    Level and length are those of a box of the echo's power and of its squared power (the offset centre of
    gravity of radar altimetry: Wingham et al. 1986, "New techniques in satellite altimeter tracking systems").
    The first cell of the box to come through is late by about one look, and its length, from as many looks as
    it has, is uncertain by its own share of them.
    """
    if len(runs.row) == 0:
        return Ranges(range_m=np.zeros(0), sigma_m=np.zeros(0))
    row, bins, begin = runs.cells()
    power = np.maximum(runs.power[row, bins] - runs.noise[row, bins], 0.0)
    total = np.add.reduceat(power, begin)
    square = np.maximum(np.add.reduceat(power**2, begin), np.finfo(float).tiny)
    # E[P^2] = 2 mu^2: a box of n bins at the level mu has total^2 / sum(P^2) = n / 2.
    level, length = square / np.maximum(total, np.finfo(float).tiny) / 2, 2 * total**2 / square
    number = np.repeat(np.arange(len(begin)), runs.stop - runs.start)
    above = np.flatnonzero(power >= EDGE_SHARE * level[number])
    _, first = np.unique(number[above], return_index=True)
    cell = bins[above[first]]
    here = runs.power[runs.row, cell]
    before = runs.power[runs.row, np.maximum(cell - 1, 0)]
    missing = (EDGE_SHARE * level - before) / np.maximum(here - before, np.finfo(float).tiny)
    looks = np.maximum(length * runs.looks_per_bin, 1.0)
    return Ranges(
        range_m=(cell - 1 + np.clip(missing, 0.0, 1.0) + EDGE_TO_MIDDLE * length) * runs.bin_m,
        sigma_m=np.hypot(1 / runs.looks_per_bin, EDGE_TO_MIDDLE * length / np.sqrt(looks)) * runs.bin_m,
    )


def model_fit_range(runs: EchoRuns) -> Ranges:
    """Return the range on boresight of the sloping plane whose echo through this beam fits best.

    Range, slope and power are fitted by the likelihood of exponential powers; see `beam_profile`. Without a
    known antenna there is nothing to fit, and the centroid stands in.
    """
    centroid = centroid_range(runs)
    if runs.beam is None or len(runs.row) == 0:
        return centroid
    fit = fit_echo(runs.beam, runs.power, runs.noise, runs.row, runs.start, runs.stop, centroid.range_m / runs.bin_m)
    scale = runs.bin_m / np.sqrt(runs.looks_per_bin)
    return Ranges(range_m=fit.centre * runs.bin_m, sigma_m=fit.sigma * scale)


@dataclass(frozen=True)
class _Shape:
    """Moments of echoes in bins: centre, root-mean-square width, deviation of the centre under speckle."""

    centre: Float[np.ndarray, " echo"]
    width: Float[np.ndarray, " echo"]
    speckle: Float[np.ndarray, " echo"]


def _shape(runs: EchoRuns) -> _Shape:
    if len(runs.row) == 0:
        return _Shape(np.zeros(0), np.zeros(0), np.zeros(0))
    row, bins, begin = runs.cells()
    weight = np.maximum(runs.power[row, bins] - runs.noise[row, bins], 0.0)
    total = np.add.reduceat(weight, begin)
    safe = np.where(total > 0, total, 1.0)
    centre = np.where(total > 0, np.add.reduceat(weight * bins, begin) / safe, runs.peak)
    away = (bins - np.repeat(centre, runs.stop - runs.start)) ** 2
    width = np.sqrt(np.add.reduceat(weight * away, begin) / safe)
    speckle = np.sqrt(np.add.reduceat(weight**2 * away, begin) / 2 / runs.looks_per_bin) / safe
    # A single bin has no width of its own: the range lies anywhere in it.
    least = np.sqrt(1 / 12)
    return _Shape(centre, np.maximum(width, least), np.maximum(speckle, least * 0.1))


ESTIMATORS: dict[str, Callable[[EchoRuns], Ranges]] = {
    "peak": peak_range,
    "centroid": centroid_range,
    "leading_edge": leading_edge_range,
    "model_fit": model_fit_range,
}
