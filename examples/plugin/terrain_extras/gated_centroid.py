"""A range estimator: the mean range of the cells near the strongest one's power."""

from typing import Annotated

import numpy as np
from pydantic import Field

from sionna_radar import Parameters, register_range_estimator
from sionna_radar.detection import Ranges
from sionna_radar.scenario import Real


class GatedCentroidParameters(Parameters):
    """gate_db: how far below the strongest cell of an echo others still count."""

    gate_db: Annotated[Real, Field(gt=0, le=60)] = 6.0


@register_range_estimator("gated_centroid", GatedCentroidParameters)
class GatedCentroid:
    """Weighs the bins of an echo by their power, those below the gate by zero."""

    def __init__(self, parameters):
        self.share = 10 ** (-parameters.gate_db / 10)

    def __call__(self, spans):
        row, bins, begin = spans.cells()
        power = spans.power[row, bins]
        length = spans.stop - spans.start
        power = np.where(power >= self.share * np.repeat(np.maximum.reduceat(power, begin), length), power, 0.0)
        total = np.add.reduceat(power, begin)
        mean = np.add.reduceat(power * bins, begin) / total
        spread = np.add.reduceat(power**2 * (bins - np.repeat(mean, length)) ** 2, begin) / 2 / spans.looks_per_bin
        return Ranges(range_m=mean * spans.bin_m, sigma_m=np.maximum(np.sqrt(spread) / total, 0.1) * spans.bin_m)
