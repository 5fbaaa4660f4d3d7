"""How scatterers of a surface that moves lose their phase, like those of grass in the wind.

Each scatterer has a Doppler shift of its own for good, drawn from the two-sided exponential distribution that the
spectra of windblown vegetation show (Billingsley 2002, "Low-Angle Radar Land Clutter"). The shifts turn phases
and do not move the scatterers, which stay where they are in the mean.
"""

import math


def wander_hz(decorrelation_time_s: float) -> float:
    """Return the mean size of the Doppler shifts, for the time after which the field's correlation has fallen to 1 / e.

    The characteristic function of the two-sided exponential distribution of mean size s is 1 / (1 + (2 pi s t)^2), the
    correlation of the field with itself a time t later.
    """
    return math.sqrt(math.e - 1) / (2 * math.pi * decorrelation_time_s)
