"""The range of an echo's leading edge, moved to its middle."""

import numpy as np

from sionna_radar.detection.ranging.estimator import EchoSpans, Ranges, register_range_estimator

# The leading edge is where the echo first reaches this share of its level.
EDGE_SHARE = 0.5
# Edge to middle of a Gaussian echo, over the length of its box: the box of exp(-x^2 / 2 s^2) is 2 sqrt(pi) s
# long and 1 / sqrt(2) high, and half of that is reached sqrt(3 log 2) s before the middle.
EDGE_TO_MIDDLE = float(np.sqrt(3 * np.log(2)) / (2 * np.sqrt(np.pi)))


@register_range_estimator("leading_edge")
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
        number = np.repeat(np.arange(len(begin)), spans.stop - spans.start)
        above = np.flatnonzero(power >= EDGE_SHARE * level[number])
        _, first = np.unique(number[above], return_index=True)
        cell = bins[above[first]]
        here = spans.power[spans.row, cell]
        before = spans.power[spans.row, np.maximum(cell - 1, 0)]
        missing = (EDGE_SHARE * level - before) / np.maximum(here - before, np.finfo(float).tiny)
        looks = np.maximum(length * spans.looks_per_bin, 1.0)
        return Ranges(
            range_m=(cell - 1 + np.clip(missing, 0.0, 1.0) + EDGE_TO_MIDDLE * length) * spans.bin_m,
            sigma_m=np.hypot(1 / spans.looks_per_bin, EDGE_TO_MIDDLE * length / np.sqrt(looks)) * spans.bin_m,
        )
