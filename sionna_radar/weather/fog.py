"""Attenuation of fog and cloud, given by liquid water, and the liquid water of a fog of some visibility.

Fog and cloud consist of droplets far smaller than the wavelength (ITU-R P.840). Their attenuation follows from the mass
of liquid water alone. Visibility also depends on the droplet sizes, so a mass of water derived from a visibility
(`liquid_water_of_visibility_g_per_m3`) is that of a mean fog. P.840 names two typical cases (`FogClass`), which that
relation matches within a third.
"""

import math
from enum import Enum

from sionna_radar.weather.permittivity import water_permittivity
from sionna_radar.weather.validity import require_between, require_not_negative

FOG_SOURCE = "the Rayleigh form of ITU-R P.840"
# P.840: droplets "generally less than 0.01 cm" are Rayleigh scatterers up to 200 GHz.
FOG_MIN_FREQUENCY_HZ = 1e9
FOG_MAX_FREQUENCY_HZ = 200e9
# P.840-9 Annex 1, section 2: K_l = 0.819 f / (eps'' (1 + eta^2)), f in GHz, K_l in (dB/km)/(g/m3).
# Read in crc-covlib itur_p840.py and ITU-Rpy itu840.py; a test derives it from Rayleigh absorption.
DB_PER_KM_PER_GHZ = 0.819


class FogClass(Enum):
    """Typical fogs by P.840 (read in ITU-Rpy, docs/apidoc/itu840.rst): liquid water density in g/m3."""

    MEDIUM = 0.05
    """Visibility of the order of 300 m."""
    THICK = 0.5
    """Visibility of the order of 50 m."""

    @property
    def liquid_water_g_per_m3(self) -> float:
        """Return the mass of liquid water in a cubic metre of fog."""
        return float(self.value)

    @property
    def visibility_m(self) -> float:
        """Return the visibility that P.840 gives with the water."""
        return 300.0 if self is FogClass.MEDIUM else 50.0


# Kunkel 1984 (J. Climate Appl. Meteor. 23, 34-41): optical extinction 144.7 M^0.88 per km, M in g/m3, from droplets
# counted in advection fog. The paper was not at hand; both numbers were read in the visibility diagnostic of the
# Unified Post Processor (CALVIS, after Stoelinga and Warner 1999), with 2 % of contrast left at the visibility.
EXTINCTION_PER_KM = 144.7
EXTINCTION_EXPONENT = 0.88
CONTRAST = 0.02


def liquid_water_of_visibility_g_per_m3(visibility_m: float) -> float:
    """Return the liquid water of a mean fog for a visibility (Kunkel 1984); single fogs differ by a factor of a few."""
    extinction_per_km = -math.log(CONTRAST) / (visibility_m / 1000.0)
    return float((extinction_per_km / EXTINCTION_PER_KM) ** (1.0 / EXTINCTION_EXPONENT))


def visibility_of_liquid_water_m(liquid_water_g_per_m3: float) -> float:
    """Return the visibility in a mean fog for its liquid water (Kunkel 1984)."""
    extinction_per_km = EXTINCTION_PER_KM * liquid_water_g_per_m3**EXTINCTION_EXPONENT
    return float(-1000.0 * math.log(CONTRAST) / extinction_per_km)


def fog_coefficient(frequency_hz: float, temperature_k: float) -> float:
    """Return K_l, the attenuation in dB/km by 1 g/m3 of droplets.

    Source: ITU-R P.840-9, Annex 1, section 2; up to 200 GHz.
    """
    require_between("frequency_hz", frequency_hz, FOG_MIN_FREQUENCY_HZ, FOG_MAX_FREQUENCY_HZ, FOG_SOURCE)
    permittivity = water_permittivity(frequency_hz, temperature_k)
    eta = (2.0 + permittivity.real) / permittivity.imag
    return DB_PER_KM_PER_GHZ * frequency_hz / 1e9 / (permittivity.imag * (1.0 + eta**2))


def fog_attenuation_db_per_km(frequency_hz: float, *, liquid_water_g_per_m3: float, temperature_k: float) -> float:
    """Return the one-way specific attenuation of fog or cloud, K_l M (ITU-R P.840-9, Annex 1, section 2)."""
    require_not_negative("liquid_water_g_per_m3", liquid_water_g_per_m3)
    return fog_coefficient(frequency_hz, temperature_k) * liquid_water_g_per_m3
