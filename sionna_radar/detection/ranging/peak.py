"""The range of an echo's strongest bin."""

import numpy as np

from sionna_radar.detection.ranging.estimator import EchoSpans, Ranges, register_range_estimator
from sionna_radar.detection.ranging.moments import moments


@register_range_estimator("peak")
class PeakRange:
    """The range of the strongest bin, refined by a parabola through the logarithms of three bins.

    Under speckle any bin of the echo may be the strongest, so the echo's own width is the uncertainty.
    """

    def __call__(self, spans: EchoSpans) -> Ranges:
        """Return the ranges of some echoes."""
        last = spans.power.shape[1] - 1
        inner = np.clip(spans.peak, 1, last - 1)
        tiny = np.finfo(float).tiny
        left, middle, right = (np.log(spans.power[spans.row, inner + k] + tiny) for k in (-1, 0, 1))
        curvature = left - 2 * middle + right
        curved = curvature < 0
        step = np.where(curved, 0.5 * (left - right) / np.where(curved, curvature, 1.0), 0.0)
        shape = moments(spans)
        return Ranges(range_m=(inner + np.clip(step, -1.0, 1.0)) * spans.bin_m, sigma_m=shape.width * spans.bin_m)
