"""The complex permittivity of liquid water and of ice.

Two models of water stand here, both double-Debye. ITU-R P.840 is for drops in the air, whose attenuation it was fitted
for, down to supercooled fog. ITU-R P.527 is for water on the ground and in soil, snow and plants, whose mixing formulas
it belongs to. At 77 GHz and 10 deg C they differ by 0.3 %, at 0 deg C by 1 %.
"""

import math

from sionna_radar.weather.validity import require_between

# ITU-R P.840-9 (08/2023), Annex 1, section 2; the form of Liebe, Hufford and Manabe 1991 (Int. J. Infrared
# Millimeter Waves 12, 659-675) with a second relaxation step that does not depend on temperature.
# Read in two independent restatements: crc-covlib itur_p840.py (P.840-9), ITU-Rpy itu840.py (P.840-6 to -8).
WATER_SOURCE = "the double-Debye permittivity of water (ITU-R P.840)"
LOWEST_FREQUENCY_HZ = 1e9
HIGHEST_FREQUENCY_HZ = 1000e9  # the fit of Liebe et al. 1991 extends to 1 THz
# Our choice: supercooled fog to a warm shower. The relaxation frequency is a parabola in 300 K/T, fitted to
# "atmospheric temperatures" (Liebe et al. 1991, abstract), and reverses far below this range.
WATER_MIN_TEMPERATURE_K = 253.15
HIGHEST_TEMPERATURE_K = 313.15
WATER_DENSITY_KG_PER_M3 = 1000.0


def water_permittivity(frequency_hz: float, temperature_k: float) -> complex:
    """Return the relative permittivity of liquid water, its imaginary part positive (time as exp(-i w t)).

    Source: ITU-R P.840-9, Annex 1, section 2; 1 to 1000 GHz.
    """
    require_between("frequency_hz", frequency_hz, LOWEST_FREQUENCY_HZ, HIGHEST_FREQUENCY_HZ, WATER_SOURCE)
    require_between("temperature_k", temperature_k, WATER_MIN_TEMPERATURE_K, HIGHEST_TEMPERATURE_K, WATER_SOURCE)
    theta = 300.0 / temperature_k - 1.0
    optical = 3.52
    principal, secondary = _relaxations(frequency_hz, theta, 20.20 - 146.0 * theta + 316.0 * theta**2, optical)
    return optical + principal + secondary


def surface_water_permittivity(frequency_hz: float, temperature_k: float) -> complex:
    """Return the relative permittivity of liquid water as in soil, snow and plants, its imaginary part positive.

    Source: ITU-R P.527-6, eqs. 5 to 13; up to 1000 GHz.
    """
    theta = 300.0 / temperature_k - 1.0
    optical = 3.52 - 7.52 * theta
    principal, secondary = _relaxations(frequency_hz, theta, surface_water_relaxation_ghz(temperature_k), optical)
    return principal + secondary + optical


def surface_water_relaxation_ghz(temperature_k: float) -> float:
    """Return the first relaxation frequency of water, GHz (ITU-R P.527-6, eq. 12)."""
    theta = 300.0 / temperature_k - 1.0
    return 20.20 - 146.4 * theta + 316.0 * theta**2


def _relaxations(frequency_hz: float, theta: float, relaxation_ghz: float, optical: float) -> tuple[complex, complex]:
    """Return the two Debye terms, which both models share."""
    frequency_ghz = frequency_hz / 1e9
    static = 77.66 + 103.3 * theta
    intermediate = 0.0671 * static
    principal = (static - intermediate) / (1.0 - 1j * frequency_ghz / relaxation_ghz)
    return principal, (intermediate - optical) / (1.0 - 1j * frequency_ghz / (39.8 * relaxation_ghz))


ICE_SOURCE = "the permittivity of ice (ITU-R P.527-6, section 5.1.3.1; Maetzler 2006)"
MELTING_K = 273.15
ICE_MIN_TEMPERATURE_K = MELTING_K - 60.0
ICE_DENSITY_KG_PER_M3 = 917.0


def ice_permittivity(frequency_hz: float, temperature_k: float) -> complex:
    """Return the relative permittivity of pure ice, its imaginary part positive (time as exp(-i w t)).

    Source: ITU-R P.527-6, eqs. 28 to 34; up to 1000 GHz, -60 to 0 deg C. How its numbers were read and checked:
    `surfaces.permittivity`.
    """
    require_between("frequency_hz", frequency_hz, 0.0, HIGHEST_FREQUENCY_HZ, ICE_SOURCE)
    require_between("temperature_k", temperature_k, ICE_MIN_TEMPERATURE_K, MELTING_K, ICE_SOURCE)
    f = frequency_hz / 1e9
    temperature_c = temperature_k - MELTING_K
    theta = 300.0 / temperature_k - 1.0
    low_coefficient = (0.00504 + 0.0062 * theta) * math.exp(-22.1 * theta)  # eq. 31
    tail = math.exp(-335.0 / temperature_k)  # eq. 33
    high_coefficient = (
        0.0207 / temperature_k * tail / (tail - 1.0) ** 2 + 1.16e-11 * f**2 + math.exp(-9.963 + 0.0372 * temperature_c)
    )  # eq. 32
    return complex(3.1884 + 0.00091 * temperature_c, low_coefficient / f + high_coefficient * f)  # eqs. 29, 30
