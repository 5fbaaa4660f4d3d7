"""Samples of the main lobe, even but on no lattice, so that few of them cross an edge at once."""

import numpy as np
from jaxtyping import Float

from sionna_radar.mapping.beam import BeamNodes

LEAST_GAIN = 3e-3


def lobe_samples(beam: BeamNodes, count: int) -> tuple[Float[np.ndarray, "sample 3"], Float[np.ndarray, " sample"]]:
    """Return directions across the main lobe in the antenna frame, and the share of the power around each.

    Parameters
    ----------
    beam:
        The antenna's main lobe.
    count:
        Of samples in the rectangle of direction cosines around it, of which those too weak to matter are left out.

    """
    # The sequence of Roberts (2018): fractional parts of multiples of powers of the plastic number's inverse.
    even = (np.arange(1, count + 1)[:, None] * np.array([0.7548776662466927, 0.5698402909980532])) % 1.0
    u = beam.azimuth[0] + even[:, 0] * np.ptp(beam.azimuth)
    v = beam.elevation[0] + even[:, 1] * np.ptp(beam.elevation)
    direction = np.column_stack([np.sqrt(np.maximum(1 - u**2 - v**2, 0.0)), u, v])
    gain = beam.two_way(direction)
    seen = gain > LEAST_GAIN
    return direction[seen], gain[seen] / gain.sum()
