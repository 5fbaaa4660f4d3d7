"""Attenuation by the air itself: oxygen and water vapour, line by line (ITU-R P.676, Annex 1).

At 77 GHz it is about 0.35 dB/km, seven tenths of it by vapour. Valid from 1 to 1000 GHz.
"""

from dataclasses import dataclass

import numpy as np

from sionna_radar.weather.gas_lines import OXYGEN_LINES, VAPOUR_LINES
from sionna_radar.weather.validity import require_between, require_not_negative

SOURCE = "ITU-R P.676-13, Annex 1"
LOWEST_FREQUENCY_HZ = 1e9
HIGHEST_FREQUENCY_HZ = 1000e9
# The equations and numbers of Annex 1, section 1, as restated in crc-covlib src/ITURP_676.cpp (P.676-13) and
# ITU-Rpy itu676.py (P.676-12), which agree; tests compare them with the ITU's validation examples.


@dataclass(frozen=True, kw_only=True)
class Air:
    """The state of the air. The defaults are the conditions of the ITU's validation examples of P.676.

    dry_pressure_pa: of the air without its vapour.
    vapour_density_g_per_m3: mass of water vapour in a cubic metre.
    """

    dry_pressure_pa: float = 101325.0
    temperature_k: float = 288.15
    vapour_density_g_per_m3: float = 7.5

    def __post_init__(self) -> None:
        require_not_negative("dry_pressure_pa", self.dry_pressure_pa)
        require_not_negative("vapour_density_g_per_m3", self.vapour_density_g_per_m3)
        require_between("temperature_k", self.temperature_k, 150.0, 350.0, "air on Earth")

    @property
    def dry_pressure_hpa(self) -> float:
        """Return the pressure in the unit of P.676."""
        return self.dry_pressure_pa / 100.0

    @property
    def vapour_pressure_hpa(self) -> float:
        """Return the partial pressure of the vapour (P.676-13, Annex 1)."""
        return self.vapour_density_g_per_m3 * self.temperature_k / 216.7

    @property
    def theta(self) -> float:
        """Return 300 K over the temperature."""
        return 300.0 / self.temperature_k


def gas_attenuation_db_per_km(frequency_hz: float, air: Air) -> float:
    """Return the one-way specific attenuation of air (P.676-13, Annex 1, eq. 1), 1 to 1000 GHz."""
    return dry_air_attenuation_db_per_km(frequency_hz, air) + vapour_attenuation_db_per_km(frequency_hz, air)


def dry_air_attenuation_db_per_km(frequency_hz: float, air: Air) -> float:
    """Return the part due to oxygen lines and the dry continuum."""
    frequency_ghz = _checked_ghz(frequency_hz)
    return 0.1820 * frequency_ghz * (_oxygen_lines(frequency_ghz, air) + _dry_continuum(frequency_ghz, air))


def vapour_attenuation_db_per_km(frequency_hz: float, air: Air) -> float:
    """Return the part due to water vapour."""
    frequency_ghz = _checked_ghz(frequency_hz)
    return 0.1820 * frequency_ghz * _vapour_lines(frequency_ghz, air)


def _checked_ghz(frequency_hz: float) -> float:
    require_between("frequency_hz", frequency_hz, LOWEST_FREQUENCY_HZ, HIGHEST_FREQUENCY_HZ, SOURCE)
    return frequency_hz / 1e9


def _oxygen_lines(f: float, air: Air) -> float:
    # The lines overlap so much that they interfere: `mixing` skews their shapes.
    line, a1, a2, a3, a4, a5, a6 = OXYGEN_LINES.T
    p, e, theta = air.dry_pressure_hpa, air.vapour_pressure_hpa, air.theta
    strength = a1 * 1e-7 * p * theta**3 * np.exp(a2 * (1.0 - theta))
    width = np.sqrt((a3 * 1e-4 * (p * theta ** (0.8 - a4) + 1.1 * e * theta)) ** 2 + 2.25e-6)
    mixing = (a5 + a6 * theta) * 1e-4 * (p + e) * theta**0.8
    below = (width - mixing * (line - f)) / ((line - f) ** 2 + width**2)
    above = (width - mixing * (line + f)) / ((line + f) ** 2 + width**2)
    return float(np.sum(strength * f / line * (below + above)))


def _dry_continuum(f: float, air: Air) -> float:
    # The Debye spectrum of oxygen and pressure-induced absorption by nitrogen.
    p, e, theta = air.dry_pressure_hpa, air.vapour_pressure_hpa, air.theta
    debye_width = 5.6e-4 * (p + e) * theta**0.8
    if debye_width == 0:
        return 0.0
    oxygen = 6.14e-5 / (debye_width * (1.0 + (f / debye_width) ** 2))
    nitrogen = 1.4e-12 * p * theta**1.5 / (1.0 + 1.9e-5 * f**1.5)
    return float(f * p * theta**2 * (oxygen + nitrogen))


def _vapour_lines(f: float, air: Air) -> float:
    # Like oxygen, without interference; the width combines pressure and Doppler broadening.
    line, b1, b2, b3, b4, b5, b6 = VAPOUR_LINES.T
    p, e, theta = air.dry_pressure_hpa, air.vapour_pressure_hpa, air.theta
    strength = b1 * 0.1 * e * theta**3.5 * np.exp(b2 * (1.0 - theta))
    pressure_width = b3 * 1e-4 * (p * theta**b4 + b5 * e * theta**b6)
    width = 0.535 * pressure_width + np.sqrt(0.217 * pressure_width**2 + 2.1316e-12 * line**2 / theta)
    below = width / ((line - f) ** 2 + width**2)
    above = width / ((line + f) ** 2 + width**2)
    return float(np.sum(strength * f / line * (below + above)))
