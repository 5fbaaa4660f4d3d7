"""Effects of weather along a two-way path: loss of power, the echo of rain itself, and the wet radome.

A wet radome carries a water film. Its thickness depends on the rain rate and sets its transmission. The dry radome is
assumed to be lossless, like a half-wavelength shell at its carrier, so only the film in air is modelled. The film's
reflection into the receiver (at zero range) is not simulated.
"""

import cmath
import math

import numpy as np
from jaxtyping import Float
from scipy.constants import g, speed_of_light
from scipy.special import expn

from sionna_radar.weather.permittivity import water_permittivity
from sionna_radar.weather.validity import ValidityError, require_not_negative

# Nepers of power, both ways, in a metre of 1 dB/km one way.
NEPERS_PER_M = 2.0 * math.log(10.0) / 10.0 / 1000.0


def two_way_attenuation(
    range_m: Float[np.ndarray, " n"], specific_attenuation_db_per_km: float | Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the two-way power transmittance (at most 1) for an echo from each range.

    The weather is uniform along the path; specific attenuations of gases, fog and rain add up in dB.
    """
    lowest = float(np.min(specific_attenuation_db_per_km, initial=np.inf))
    require_not_negative("specific_attenuation_db_per_km", lowest)
    return np.exp(-NEPERS_PER_M * specific_attenuation_db_per_km * range_m)


def rain_clutter_power(
    range_edges_m: Float[np.ndarray, " edge"],
    *,
    reflectivity_per_m: float,
    two_way_beam_sr: float,
    peak_gain: float,
    wavelength_m: float,
    specific_attenuation_db_per_km: float,
) -> Float[np.ndarray, " cell"]:
    """Return the mean power of the rain echo in each range cell, over the transmitted power.

    range_edges_m: edges of the cells, increasing and positive; one fewer cell than edges.
    two_way_beam_sr: Omega_2, the integral of (G/G0)^2 over the solid angle filled with rain.
    peak_gain: G0, a ratio.

    Derivation. A volume dV = r^2 dr dOmega has the cross-section eta dV; drops move independently, so their
    powers add. Each follows the radar equation (Rouveure et al. 2017, eq. 3), attenuated both ways:

        dP/P_t = G(Omega)^2 lambda^2 eta r^2 dr dOmega exp(-a r) / ((4 pi)^3 r^4).

    The direction integrates to G0^2 Omega_2, and r^2 of volume reduces r^4 of spreading to r^2:

        P/P_t = G0^2 lambda^2 Omega_2 eta / (4 pi)^3  *  integral of exp(-a r)/r^2 over the cell,

    with a = 2 (ln 10 / 10) dB/km / 1000. From r to infinity the integral is E_2(a r)/r, E_2 the exponential
    integral, so the cell's share is exact however thick it is; without loss it is 1/r1 - 1/r2. The echo is
    Gaussian noise around this mean (intensity exponential), with the Doppler spread of falling drops.
    """
    require_not_negative("reflectivity_per_m", reflectivity_per_m)
    require_not_negative("specific_attenuation_db_per_km", specific_attenuation_db_per_km)
    if len(range_edges_m) < 2 or range_edges_m[0] <= 0 or np.any(np.diff(range_edges_m) <= 0):
        message = "range_edges_m must increase and be positive: the echo grows without bound towards the antenna"
        raise ValidityError(message)
    nepers_per_m = NEPERS_PER_M * specific_attenuation_db_per_km
    beyond_per_m = expn(2, nepers_per_m * range_edges_m) / range_edges_m
    constant = peak_gain**2 * wavelength_m**2 * two_way_beam_sr * reflectivity_per_m / (4.0 * math.pi) ** 3
    return constant * (beyond_per_m[:-1] - beyond_per_m[1:])


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
