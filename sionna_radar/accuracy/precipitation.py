"""Which echoes are volume clutter (rain, snow, fog, dust): truth for a warning, not available to mapping."""

import numpy as np
from jaxtyping import Bool
from scipy.constants import speed_of_light

from sionna_radar.detection.echoes import Echoes
from sionna_radar.radar.chirp import Chirp
from sionna_radar.tracing.paths import VOLUME, Paths

# Paths this many range cells from an echo are within the main lobe of every window.
REACH_CELLS = 2.0


def from_rain(echoes: Echoes, paths: Paths, chirp: Chirp) -> Bool[np.ndarray, " echo"]:
    """Return which echoes hold more power from rain, snow, fog or dust than from anything else.

    Parameters
    ----------
    echoes:
        Echoes of a block of pulses, ranges corrected for Doppler.
    paths:
        Paths of the same pulses, sorted by pulse.
    chirp:
        The sweep, for its range cells.

    """
    rain = paths.surface == VOLUME
    if not rain.any() or len(echoes) == 0:
        return np.zeros(len(echoes), dtype=bool)
    first = paths.pulse[0]
    # Pulses are laid end to end on one range axis, so that one search serves them all.
    length_m = 2 * chirp.max_range_m + 4 * REACH_CELLS * chirp.range_resolution_m
    range_m = np.minimum(paths.delay_s * (speed_of_light / 2), length_m / 2)
    place = (paths.pulse - first) * length_m + range_m
    order = np.argsort(place)
    power = np.abs(paths.gain.astype(np.complex128)) ** 2 * np.where(rain, 1.0, -1.0)
    total = np.concatenate([[0.0], np.cumsum(power[order])])
    centre = (echoes.pulse - first) * length_m + echoes.range_m
    reach_m = REACH_CELLS * chirp.range_resolution_m
    low, high = (np.searchsorted(place[order], centre + side * reach_m) for side in (-1, 1))
    # A range with no path near it is noise, neither rain nor ground.
    led: Bool[np.ndarray, " echo"] = total[high] - total[low] > 0
    return led
