"""Paths in the frames of the antennas that they belong to, as machine code."""

from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled


@compiled
@no_type_check
def ahead(first, position, axes, hit, out):
    """Write the unit vectors from the antennas to hits, in the antennas' frames.

    first: where the hits of each pulse begin, and where the last one's end.
    """
    for pulse in range(len(position)):
        for n in range(first[pulse], first[pulse + 1]):
            x, y, z = hit[n, 0] - position[pulse, 0], hit[n, 1] - position[pulse, 1], hit[n, 2] - position[pulse, 2]
            distance = np.sqrt(x * x + y * y + z * z)
            for k in range(3):
                out[n, k] = (x * axes[pulse, 0, k] + y * axes[pulse, 1, k] + z * axes[pulse, 2, k]) / distance
