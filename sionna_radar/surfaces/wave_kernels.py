"""Orbits of waves, as machine code."""

from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.turns import turned


@compiled
@no_type_check
def orbits(place, time_s, wave, rate, amplitude, phase, offset, velocity):
    """Add the orbits of deep-water waves: up by the cosine, against the wave's direction by the sine."""
    for k in range(len(rate)):
        number = np.sqrt(wave[k, 0] ** 2 + wave[k, 1] ** 2)
        east, north = wave[k, 0] / number, wave[k, 1] / number
        for i in range(len(place)):
            angle = wave[k, 0] * place[i, 0] + wave[k, 1] * place[i, 1] - rate[k] * time_s[i] + phase[k]
            cosine, sine = turned(angle / (2.0 * np.pi))
            cosine *= amplitude[k]
            sine *= amplitude[k]
            offset[i, 0] -= east * sine
            offset[i, 1] -= north * sine
            offset[i, 2] += cosine
            velocity[i, 0] += rate[k] * east * cosine
            velocity[i, 1] += rate[k] * north * cosine
            velocity[i, 2] += rate[k] * sine
