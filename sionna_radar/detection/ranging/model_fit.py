"""The range of the plane whose echo fits best."""

import numpy as np

from sionna_radar.detection.ranging.beam_profile import fit_echo
from sionna_radar.detection.ranging.centroid import CentroidRange
from sionna_radar.detection.ranging.estimator import EchoRuns, Ranges, register_range_estimator


@register_range_estimator("model_fit")
class ModelFitRange:
    """The range on boresight of the sloping plane whose echo through this beam fits best.

    Range, slope and power are fitted by the likelihood of exponential powers; see `beam_profile`. Without a
    known antenna there is nothing to fit, and the centroid stands in.
    """

    def __call__(self, runs: EchoRuns) -> Ranges:
        """Return the ranges of some echoes."""
        centroid = CentroidRange()(runs)
        if runs.beam is None or len(runs.row) == 0:
            return centroid
        fit = fit_echo(
            runs.beam, runs.power, runs.noise, runs.row, runs.start, runs.stop, centroid.range_m / runs.bin_m
        )
        scale = runs.bin_m / np.sqrt(runs.looks_per_bin)
        return Ranges(range_m=fit.centre * runs.bin_m, sigma_m=fit.sigma * scale)
