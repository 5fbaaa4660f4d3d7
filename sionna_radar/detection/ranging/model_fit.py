"""The range of the plane whose echo fits best."""

import numpy as np

from sionna_radar.detection.ranging.beam_profile import fit_echo
from sionna_radar.detection.ranging.centroid import CentroidRange
from sionna_radar.detection.ranging.estimator import EchoSpans, Ranges, register_range_estimator


@register_range_estimator("model_fit")
class ModelFitRange:
    """The boresight range of the sloping plane whose echo through this beam fits best.

    Range, slope and power are fitted by maximum likelihood of exponential powers; see `beam_profile`. Without a
    known antenna there is no model to fit, and the centroid is returned.
    """

    def __call__(self, spans: EchoSpans) -> Ranges:
        """Return the ranges of some echoes."""
        centroid = CentroidRange()(spans)
        if spans.beam is None or len(spans.row) == 0:
            return centroid
        fit = fit_echo(
            spans.beam, spans.power, spans.noise, spans.row, spans.start, spans.stop, centroid.range_m / spans.bin_m
        )
        scale = spans.bin_m / np.sqrt(spans.looks_per_bin)
        return Ranges(range_m=fit.centre * spans.bin_m, sigma_m=fit.sigma * scale)
