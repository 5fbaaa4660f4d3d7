"""A wet radome: a water film whose thickness depends on the rain rate, and its transmission.

The dry radome is assumed to be lossless, like a half-wavelength shell at its carrier, so only the film in
air is modelled. The film's reflection into the receiver (at zero range) is not simulated.
"""

import cmath
import math

from scipy.constants import g, speed_of_light

from sionna_radar.weather.validity import require_not_negative
from sionna_radar.weather.water import water_permittivity

# Kinematic viscosity of water, m2/s: 1.79e-6 at 0 deg C, 1.31e-6 at 10, 1.00e-6 at 20 (standard tables); at 10 deg C.
# The film grows with its cube root: from 0 to 20 deg C it thins by a sixth.
VISCOSITY_M2_PER_S = 1.31e-6


def film_thickness_m(rain_rate_mm_per_h: float, radius_m: float) -> float:
    """Return the thickness of the water on a spherical radome: (3 nu a R / (2 g))^(1/3).

    Gibble 1964 (Effects of rain on transmission performance of a satellite communication system, IEEE Int. Conv. Rec.),
    as used by Anderson 1975 and Kurri and Huuskonen 2008. Derivation: at the angle t from the top the rain caught on
    the cap, R pi a^2 sin^2 t, runs off over 2 pi a sin t; a laminar film under its own weight g sin t carries
    g sin t d^3 / (3 nu) per metre. The angle cancels, so the film is equally thick everywhere. A hydrophobic
    surface has drops and rivulets instead, and less loss.
    """
    require_not_negative("rain_rate_mm_per_h", rain_rate_mm_per_h)
    rate_m_per_s = rain_rate_mm_per_h / 3.6e6
    return float((3.0 * VISCOSITY_M2_PER_S * radius_m * rate_m_per_s / (2.0 * g)) ** (1.0 / 3.0))


def film_transmission(frequency_hz: float, *, thickness_m: float, temperature_k: float) -> float:
    """Return the one-way power transmission of a water film at normal incidence.

    Including all reflections within the film: t = (1 - r^2) p / (1 - r^2 p^2), r = (1 - n)/(1 + n), p = exp(i k n d).
    """
    index = cmath.sqrt(water_permittivity(frequency_hz, temperature_k))
    edge = (1 - index) / (1 + index)
    passed = cmath.exp(2j * math.pi * frequency_hz / speed_of_light * index * thickness_m)
    return abs((1 - edge**2) * passed / (1 - edge**2 * passed**2)) ** 2


def wet_radome_loss_db(
    frequency_hz: float, *, rain_rate_mm_per_h: float, radius_m: float, temperature_k: float
) -> float:
    """Return the two-way loss in the water on a radome; zero without rain."""
    thickness_m = film_thickness_m(rain_rate_mm_per_h, radius_m)
    return -20.0 * math.log10(film_transmission(frequency_hz, thickness_m=thickness_m, temperature_k=temperature_k))
