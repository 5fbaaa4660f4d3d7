"""Range estimators (peak, centroid, leading edge, threshold, model fit, tracker) with their uncertainty.

Strongest bin, centroid, leading edge, threshold, the fit of a plane's mean echo, and a first-order loop over pulses.

Speckle: bin power is exponentially distributed about the mean echo profile; a window correlates neighbouring bins, so
that a bin counts as `looks_per_bin` independent looks. Every estimator returns the standard deviation of the range.
"""

import math
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.detection.ranging.plane_fit import BeamProfile, fit_echo


@dataclass(frozen=True, kw_only=True)
class EchoSpans:
    """Spans of spectrum bins, one per echo, and the spectra that contain them.

    power, noise: spectra and noise estimates of the block.
    row: spectrum of each span; start, stop: its bins, stop excluded; peak: its strongest bin.
    bin_m: distance between bins. first_bin: bins from range zero to the first one, which a range gate puts there.
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
    first_bin: int = 0
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
    """Echo ranges from the first bin of the spectrum on, and their standard deviations."""

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


@dataclass(frozen=True)
class Moments:
    """Moments of echoes in bins: centre, root-mean-square width, standard deviation of the centre under speckle."""

    centre: Float[np.ndarray, " echo"]
    width: Float[np.ndarray, " echo"]
    speckle: Float[np.ndarray, " echo"]


def moments(spans: EchoSpans) -> Moments:
    """Return the moments of echoes, weighted by the power above the noise."""
    if len(spans.row) == 0:
        return Moments(np.zeros(0), np.zeros(0), np.zeros(0))
    row, bins, begin = spans.cells()
    weight = np.maximum(spans.power[row, bins] - spans.noise[row, bins], 0.0)
    total = np.add.reduceat(weight, begin)
    safe = np.where(total > 0, total, 1.0)
    centre = np.where(total > 0, np.add.reduceat(weight * bins, begin) / safe, spans.peak)
    away = (bins - np.repeat(centre, spans.stop - spans.start)) ** 2
    width = np.sqrt(np.add.reduceat(weight * away, begin) / safe)
    speckle = np.sqrt(np.add.reduceat(weight**2 * away, begin) / 2 / spans.looks_per_bin) / safe
    # A single bin has no measurable width: the range is uniformly distributed in it.
    min_width = np.sqrt(1 / 12)
    single = (spans.stop - spans.start == 1) | (total <= 0)
    speckle = np.where(single, min_width, np.maximum(speckle, min_width * 0.1))
    return Moments(centre, np.maximum(width, min_width), speckle)


class CentroidRange:
    """The mean range of the span, weighted by the power above the noise.

    With exponential powers of means mu the variance of sum(P r) / sum(P) is sum(mu^2 (r - mean)^2) / sum(mu)^2
    over independent bins; P^2 / 2 is an unbiased estimate of mu^2.
    """

    def __call__(self, spans: EchoSpans) -> Ranges:
        """Return the ranges of some echoes."""
        shape = moments(spans)
        return Ranges(range_m=shape.centre * spans.bin_m, sigma_m=shape.speckle * spans.bin_m)


# Level of the leading edge, as a fraction of the echo's level.
EDGE_LEVEL = 0.5
# Edge to middle of a Gaussian echo, over the length of its box: the box of exp(-x^2 / 2 s^2) is 2 sqrt(pi) s
# long and 1 / sqrt(2) high, and half of that is reached sqrt(3 log 2) s before the middle.
EDGE_TO_MIDDLE = float(np.sqrt(3 * np.log(2)) / (2 * np.sqrt(np.pi)))


def first_crossing(
    spans: EchoSpans, level: Float[np.ndarray, " echo"]
) -> tuple[Int[np.ndarray, " echo"], Float[np.ndarray, " echo"]]:
    """Return the first bin of each span above a level over the noise, and the share of the step to it that lies below.

    A span that stays below its level, as where it is weaker than the noise everywhere, is taken at its strongest bin.
    """
    row, bins, begin = spans.cells()
    power = np.maximum(spans.power[row, bins] - spans.noise[row, bins], 0.0)
    number = np.repeat(np.arange(len(begin)), spans.stop - spans.start)
    above = np.flatnonzero((power >= level[number]) & (power > 0))
    reaching, first_above = np.unique(number[above], return_index=True)
    cell = spans.peak.copy()
    cell[reaching] = bins[above[first_above]]
    previous, edge = (
        np.maximum(spans.power[spans.row, bins] - spans.noise[spans.row, bins], 0.0)
        for bins in (np.maximum(cell - 1, 0), cell)
    )
    fraction = (level - previous) / np.maximum(edge - previous, np.finfo(float).tiny)
    return cell, np.clip(fraction, 0.0, 1.0)


class LeadingEdgeRange:
    """The range where the echo first reaches half of its level, moved to the middle by the echo's length.

    Level and length are those of a box with the echo's power and squared power (the offset centre of
    gravity of radar altimetry: Wingham et al. 1986, "New techniques in satellite altimeter tracking systems").
    Speckle delays the first cell above the level by about one look; the length, estimated from the looks of the
    box, has a relative error of one over the square root of their number.
    """

    def __call__(self, spans: EchoSpans) -> Ranges:
        """Return the ranges of the echoes."""
        if len(spans.row) == 0:
            return Ranges(range_m=np.zeros(0), sigma_m=np.zeros(0))
        row, bins, begin = spans.cells()
        power = np.maximum(spans.power[row, bins] - spans.noise[row, bins], 0.0)
        total = np.add.reduceat(power, begin)
        square = np.maximum(np.add.reduceat(power**2, begin), np.finfo(float).tiny)
        # E[P^2] = 2 mu^2: a box of n bins at the level mu has total^2 / sum(P^2) = n / 2.
        level, length = square / np.maximum(total, np.finfo(float).tiny) / 2, 2 * total**2 / square
        cell, fraction = first_crossing(spans, EDGE_LEVEL * level)
        looks = np.maximum(length * spans.looks_per_bin, 1.0)
        return Ranges(
            range_m=(cell - 1 + fraction + EDGE_TO_MIDDLE * length) * spans.bin_m,
            sigma_m=np.hypot(1 / spans.looks_per_bin, EDGE_TO_MIDDLE * length / np.sqrt(looks)) * spans.bin_m,
        )


class ThresholdRange:
    """The range where the echo first reaches half of its amplitude, as an altimeter of a wide beam reads it.

    The amplitude is that of the offset centre of gravity, the root of sum(P^4) / sum(P^2) (Wingham et al. 1986), the
    crossing that of the threshold retracker (Davis 1997, "A robust threshold retracking algorithm for measuring
    ice-sheet surface elevation change from satellite radar altimeters"). Meant for averaged powers: speckle raises the
    amplitude of N averaged powers by the root of (1 + 2/N) (1 + 3/N), and shifts the crossing by its own noise over
    the slope of the edge, stated as if bins were independent: up to twice what it is.
    """

    def __call__(self, spans: EchoSpans) -> Ranges:
        """Return the ranges of the echoes."""
        if len(spans.row) == 0:
            return Ranges(range_m=np.zeros(0), sigma_m=np.zeros(0))
        row, bins, begin = spans.cells()
        square = np.maximum(spans.power[row, bins] - spans.noise[row, bins], 0.0) ** 2
        total = np.maximum(np.add.reduceat(square, begin), np.finfo(float).tiny)
        level = EDGE_LEVEL * np.sqrt(np.add.reduceat(square**2, begin) / total)
        cell, fraction = first_crossing(spans, level)
        step = np.abs(spans.power[spans.row, cell] - spans.power[spans.row, np.maximum(cell - 1, 0)])
        edge = level / np.maximum(step, np.finfo(float).tiny)
        # An edge has at least the width of a bin.
        sigma = np.clip(edge, 1.0, spans.stop - spans.start) / np.sqrt(np.maximum(spans.looks_per_bin, 1.0))
        return Ranges(range_m=(cell - 1 + fraction) * spans.bin_m, sigma_m=sigma * spans.bin_m)


class PeakRange:
    """The range of the strongest bin, refined by a parabola through the logarithms of three bins.

    Under speckle any bin of the echo may be the strongest, so the echo's own width is the uncertainty.
    """

    def __call__(self, spans: EchoSpans) -> Ranges:
        """Return the ranges of some echoes."""
        last_bin = spans.power.shape[1] - 1
        inner = np.clip(spans.peak, 1, last_bin - 1)
        tiny = np.finfo(float).tiny
        left, middle, right = (np.log(spans.power[spans.row, inner + k] + tiny) for k in (-1, 0, 1))
        curvature = left - 2 * middle + right
        curved = curvature < 0
        step = np.where(curved, 0.5 * (left - right) / np.where(curved, curvature, 1.0), 0.0)
        shape = moments(spans)
        return Ranges(range_m=(inner + np.clip(step, -1.0, 1.0)) * spans.bin_m, sigma_m=shape.width * spans.bin_m)


class ModelFitRange:
    """The boresight range of the sloping plane whose echo through this beam fits best.

    Range, slope and power are fitted by maximum likelihood of exponential powers; see `plane_fit`. Without a
    known antenna the centroid is returned.
    """

    def __call__(self, spans: EchoSpans) -> Ranges:
        """Return the ranges of some echoes."""
        centroid = CentroidRange()(spans)
        if spans.beam is None or len(spans.row) == 0:
            return centroid
        spectra = (spans.power, spans.noise, spans.row, spans.start, spans.stop)
        fit = fit_echo(spans.beam, *spectra, centroid.range_m / spans.bin_m, spans.first_bin)
        scale = spans.bin_m / np.sqrt(spans.looks_per_bin)
        return Ranges(range_m=fit.centre * spans.bin_m, sigma_m=fit.sigma * scale)


@dataclass(frozen=True, kw_only=True)
class TrackerRange:
    """Ranges of single pulses by another estimator, to be smoothed by a first-order loop; see `RangeLoop`."""

    follows: RangeEstimator
    time_constant_s: float

    def __call__(self, spans: EchoSpans) -> Ranges:
        """Return the ranges of the echoes before the loop."""
        return self.follows(spans)


@dataclass(kw_only=True)
class RangeLoop:
    """A first-order loop over the ranges of pulses, as radio altimeters smooth their readings.

    The discrete form of tau dy/dt = x - y, with x held from pulse to pulse: y_k = y_(k-1) + a (x_k - y_(k-1)),
    a = 1 - exp(-(t_k - t_(k-1)) / tau), from the first range on. White errors of the standard deviation s leave
    s sqrt(a / (2 - a)), n pulses apart with the correlation (1 - a)^n; a ramp is followed (1 - a) / a pulses late.
    A pulse without an echo leaves the loop as it is, and gives the next one its weight.
    """

    time_constant_s: float
    time_s: float = -math.inf
    range_m: float = 0.0
    variance_m2: float = 0.0

    def follow(self, time_s: Float[np.ndarray, " pulse"], ranges: Ranges) -> Ranges:
        """Return the smoothed ranges of further pulses, and the standard deviations that independent errors leave."""
        smoothed = np.empty((2, len(time_s)))
        rows = zip(time_s.tolist(), ranges.range_m.tolist(), ranges.sigma_m.tolist(), strict=True)
        for row, (now_s, range_m, sigma_m) in enumerate(rows):
            gain = -math.expm1((self.time_s - now_s) / self.time_constant_s)
            self.time_s = now_s
            self.range_m += gain * (range_m - self.range_m)
            self.variance_m2 = (1 - gain) ** 2 * self.variance_m2 + (gain * sigma_m) ** 2
            smoothed[:, row] = self.range_m, math.sqrt(self.variance_m2)
        return Ranges(range_m=smoothed[0], sigma_m=smoothed[1])
