"""Attenuation by fog and cloud: droplets far smaller than the wavelength (ITU-R P.840).

The attenuation follows from the mass of liquid water alone. Visibility does not give that mass: it depends on
the droplets' sizes too, so no formula between the two is offered. P.840 names two typical cases
(`FogClass`); anything else is the user's liquid water density.
"""

from enum import Enum

from sionna_radar.weather.validity import require_between, require_not_negative
from sionna_radar.weather.water import water_permittivity

SOURCE = "the Rayleigh form of ITU-R P.840"
# P.840: droplets "generally less than 0.01 cm" are Rayleigh scatterers up to 200 GHz.
LOWEST_FREQUENCY_HZ = 1e9
HIGHEST_FREQUENCY_HZ = 200e9
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


def fog_coefficient(frequency_hz: float, temperature_k: float) -> float:
    """Return K_l, the attenuation in dB/km that 1 g/m3 of droplets causes.

    Source: ITU-R P.840-9, Annex 1, section 2; up to 200 GHz.
    """
    require_between("frequency_hz", frequency_hz, LOWEST_FREQUENCY_HZ, HIGHEST_FREQUENCY_HZ, SOURCE)
    permittivity = water_permittivity(frequency_hz, temperature_k)
    eta = (2.0 + permittivity.real) / permittivity.imag
    return DB_PER_KM_PER_GHZ * frequency_hz / 1e9 / (permittivity.imag * (1.0 + eta**2))


def fog_attenuation_db_per_km(
    frequency_hz: float, *, liquid_water_g_per_m3: float, temperature_k: float
) -> float:
    """Return the one-way specific attenuation of fog or cloud, K_l M (ITU-R P.840-9, Annex 1, section 2)."""
    require_not_negative("liquid_water_g_per_m3", liquid_water_g_per_m3)
    return fog_coefficient(frequency_hz, temperature_k) * liquid_water_g_per_m3
