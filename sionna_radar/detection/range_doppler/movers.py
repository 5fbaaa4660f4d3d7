"""Targets in a range-Doppler map: peaks that a CFAR detects, to a fraction of a cell."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter

from sionna_radar.detection.range_doppler.frames import RangeDopplerMap
from sionna_radar.foundation.columns import Columns


@dataclass(frozen=True, kw_only=True)
class Movers(Columns):
    """Targets found in a map, the strongest first.

    range_m: corrected for the shift that a moving target's range has in a sweep.
    range_rate_mps: positive when receding, within the unambiguous ones.
    power: of the peak, interpolated.
    """

    range_m: Float[np.ndarray, " target"]
    range_rate_mps: Float[np.ndarray, " target"]
    power: Float[np.ndarray, " target"]


def find_movers(found: RangeDopplerMap, detected: Bool[np.ndarray, "rate bin"]) -> Movers:
    """Return the targets of a map: detected cells stronger than their eight neighbours.

    The place and height of a peak are those of parabolas through the logarithms of three bins in each direction. With
    "hann" they are within 0.02 cells and 0.6 dB without zero padding, and within 0.002 cells and 0.03 dB with two bins
    in a cell. Range rates wrap.

    Parameters
    ----------
    found:
        The map.
    detected:
        Cells that exceed their threshold; see `RingCfar` and `ClutterMap`.

    """
    power = found.power
    highest = power == maximum_filter(power, size=3, mode=("wrap", "nearest"))
    rate, bin_ = np.nonzero(highest & detected)
    inside = (bin_ > 0) & (bin_ < power.shape[1] - 1)
    rate, bin_ = rate[inside], bin_[inside]
    log = np.log(np.maximum(power, np.finfo(float).tiny))
    rows = power.shape[0]
    along_rate = _vertex(log[(rate - 1) % rows, bin_], log[rate, bin_], log[(rate + 1) % rows, bin_])
    along_range = _vertex(log[rate, bin_ - 1], log[rate, bin_], log[rate, bin_ + 1])
    step_mps, step_m = np.diff(found.range_rate_mps[:2])[0], np.diff(found.range_m[:2])[0]
    rate_mps = found.range_rate_mps[rate] + along_rate[0] * step_mps
    range_m = found.range_at(found.range_m[bin_] + along_range[0] * step_m, rate_mps)
    peak = power[rate, bin_] * np.exp(along_rate[1] + along_range[1])
    order = np.argsort(-peak, kind="stable")
    return Movers(range_m=range_m[order], range_rate_mps=rate_mps[order], power=peak[order])


def _vertex(
    before: Float[np.ndarray, " n"], at: Float[np.ndarray, " n"], after: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return where parabolas through three neighbours peak, from the middle one, and how much higher."""
    bend = before - 2 * at + after
    slope = (after - before) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.where(bend < 0, -slope / bend, 0.0)
    place = np.clip(place, -0.5, 0.5)
    return place, slope * place + bend * place**2 / 2
