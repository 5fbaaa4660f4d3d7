"""The mean range of an echo."""

from sionna_radar.detection.ranging.estimator import EchoSpans, Ranges, register_range_estimator
from sionna_radar.detection.ranging.moments import moments


@register_range_estimator("centroid")
class CentroidRange:
    """The mean range of the span, weighted by the power above the noise.

    With exponential powers of means mu the variance of sum(P r) / sum(P) is sum(mu^2 (r - mean)^2) / sum(mu)^2
    over independent bins; P^2 / 2 is an unbiased estimate of mu^2.
    """

    def __call__(self, spans: EchoSpans) -> Ranges:
        """Return the ranges of some echoes."""
        shape = moments(spans)
        return Ranges(range_m=shape.centre * spans.bin_m, sigma_m=shape.speckle * spans.bin_m)
