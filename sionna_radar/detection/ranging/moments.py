"""Moments of echoes: centre, width, and how far speckle moves the centre."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.detection.ranging.estimator import EchoSpans


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
    # A single bin has no measurable width: the range lies anywhere in it.
    least = np.sqrt(1 / 12)
    return Moments(centre, np.maximum(width, least), np.maximum(speckle, least * 0.1))
