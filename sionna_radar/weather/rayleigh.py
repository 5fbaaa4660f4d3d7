"""Particles far smaller than the wavelength: attenuation and backscatter."""

import math
from dataclasses import dataclass

from scipy.constants import speed_of_light

DB_PER_KM_PER_NEPER_PER_M = 10.0 * math.log10(math.e) * 1000.0


def clausius_mossotti(permittivity: complex) -> complex:
    """Return (eps - 1)/(eps + 2), the polarizability of a sphere over three times its volume."""
    return (permittivity - 1.0) / (permittivity + 2.0)


@dataclass(frozen=True, kw_only=True)
class Aerosol:
    """Small spheres of one substance in air.

    volume_fraction: cubic metres of substance in a cubic metre of air.
    echo_radius_m: (mean r^6 / mean r^3)^(1/3), the radius of equal spheres with the same mass and echo.
    """

    permittivity: complex
    volume_fraction: float
    echo_radius_m: float

    def attenuation_db_per_km(self, frequency_hz: float) -> float:
        """Return the one-way specific attenuation: absorption by the spheres and, far less, scattering."""
        wave_number = 2.0 * math.pi * frequency_hz / speed_of_light
        factor = clausius_mossotti(self.permittivity)
        absorbed = 3.0 * wave_number * factor.imag
        scattered = 2.0 * wave_number**4 * abs(factor) ** 2 * self.echo_radius_m**3
        return DB_PER_KM_PER_NEPER_PER_M * self.volume_fraction * (absorbed + scattered)

    def reflectivity_per_m(self, frequency_hz: float) -> float:
        """Return the radar cross-section of a cubic metre (m2/m3).

        A sphere has 4 pi k^4 |K|^2 r^6, and there are volume_fraction / (4 pi r^3 / 3) of them.
        """
        wave_number = 2.0 * math.pi * frequency_hz / speed_of_light
        factor = abs(clausius_mossotti(self.permittivity)) ** 2
        return 3.0 * wave_number**4 * factor * self.volume_fraction * self.echo_radius_m**3
