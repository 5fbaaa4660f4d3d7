"""The extent of the main lobe of an antenna.

Each use has its own level, as two-way power over the peak: `LIT` for the mappable ground of a survey, `FOLDING` for
echoes that must not alias into an image, `FOLLOWED` for models of the whole echo.
"""

from typing import Final, no_type_check

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.foundation.compiled import compiled
from sionna_radar.radar.antenna import Antenna, Cut

# Half of the one-way power: inside the usual half-power beam.
LIT: Final = 0.25
# Echoes aliasing in from farther out are 20 dB down, less than the side lobes of a focused point.
FOLDING: Final = 1e-2
# 0.3 % of an echo's power is farther out than 30 dB down, less than its speckle reveals.
FOLLOWED: Final = 1e-3


def lobe_samples(cut: Cut, level: float) -> slice:
    """Return the samples of a cut around its peak with at least a given level of the peak's two-way power."""
    power = cut.voltage**4
    peak = int(np.argmax(power))
    weak = np.flatnonzero(power < level * power[peak])
    left, right = weak[weak < peak], weak[weak > peak]
    return slice(int(left[-1]) + 1 if len(left) else 0, int(right[0]) if len(right) else len(power))


def in_main_lobe(antenna: Antenna, direction: Float[np.ndarray, "n 3"], level: float = LIT) -> Bool[np.ndarray, " n"]:
    """Mark the unit vectors, in the antenna's frame, whose two-way gain relative to the peak is at least a level."""
    if not antenna.separable:
        return antenna.gain(direction) ** 2 >= level * antenna.peak_gain**2

    mask = np.empty(len(direction), dtype=np.bool_)
    cuts = (np.ascontiguousarray(cut.voltage, dtype=np.float64) for cut in (antenna.azimuth, antenna.elevation))
    within(np.ascontiguousarray(direction, dtype=np.float64), *cuts, float(level), mask)
    return mask


def reach_of_power(antenna: Antenna, outside: float) -> tuple[float, float]:
    """Return half extents (left, up) in direction cosines that contain all but a fraction of the two-way power."""
    if not antenna.separable:
        return antenna.two_way.reach(outside)
    return _reach(antenna.azimuth, outside), _reach(antenna.elevation, outside)


def _reach(cut: Cut, tail_power: float) -> float:
    lower, upper = np.interp([tail_power / 2, 1 - tail_power / 2], cut.two_way_distribution, cut.cosine)
    return float(max(-lower, upper))


@compiled
@no_type_check
def voltage_at(voltage, cosine):
    """Return a `Cut` at a direction cosine."""
    position = (min(max(cosine, -1.0), 1.0) + 1.0) * ((len(voltage) - 1) / 2)
    lower = min(int(position), len(voltage) - 2)
    weight = position - lower
    return voltage[lower] * (1 - weight) + voltage[lower + 1] * weight


@compiled
@no_type_check
def within(direction, azimuth, elevation, level, inside):
    """Mark the unit vectors at which the two-way power, relative to the peak, is at least a level."""
    for n in range(len(direction)):
        voltage = voltage_at(azimuth, direction[n, 1]) * voltage_at(elevation, direction[n, 2])
        gain = voltage * voltage * max(direction[n, 0], 0.0)
        inside[n] = gain * gain >= level
