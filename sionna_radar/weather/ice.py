"""The complex permittivity of pure ice: ITU-R P.527."""

import math

from sionna_radar.weather.validity import require_between

SOURCE = "the permittivity of ice (ITU-R P.527-6, section 5.1.3.1; Maetzler 2006)"
HIGHEST_FREQUENCY_HZ = 1000e9
MELTING_K = 273.15
LOWEST_TEMPERATURE_K = MELTING_K - 60.0
DENSITY_KG_PER_M3 = 917.0


def ice_permittivity(frequency_hz: float, temperature_k: float) -> complex:
    """Return the relative permittivity of pure ice, its imaginary part positive (time as exp(-i w t)).

    Source: ITU-R P.527-6, eqs. 28 to 34; up to 1000 GHz, -60 to 0 deg C. How its numbers were read and checked:
    `scene.permittivity`.
    """
    require_between("frequency_hz", frequency_hz, 0.0, HIGHEST_FREQUENCY_HZ, SOURCE)
    require_between("temperature_k", temperature_k, LOWEST_TEMPERATURE_K, MELTING_K, SOURCE)
    f = frequency_hz / 1e9
    temperature_c = temperature_k - MELTING_K
    theta = 300.0 / temperature_k - 1.0
    low = (0.00504 + 0.0062 * theta) * math.exp(-22.1 * theta)  # eq. 31
    tail = math.exp(-335.0 / temperature_k)  # eq. 33
    high = (
        0.0207 / temperature_k * tail / (tail - 1.0) ** 2 + 1.16e-11 * f**2 + math.exp(-9.963 + 0.0372 * temperature_c)
    )  # eq. 32
    return complex(3.1884 + 0.00091 * temperature_c, low / f + high * f)  # eqs. 29, 30
