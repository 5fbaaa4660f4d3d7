"""Gaseous attenuation by oxygen and water vapour, line by line (ITU-R P.676, Annex 1).

At 77 GHz it is about 0.35 dB/km, seven tenths of it by vapour. Valid from 1 to 1000 GHz.

The spectral lines of oxygen and water vapour are those of Tables 1 and 2 of ITU-R P.676-13, Annex 1. Each has its
frequency in GHz, then six coefficients, in the units of the Recommendation. Taken from crc-covlib src/ITURP_676.cpp
(P.676-13); ITU-Rpy test/test_data/v12_lines_oxygen.txt and itur/data/676/v13_lines_water_vapour.txt hold the same
values.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.weather.validity import require_between, require_not_negative

# Table 1: f0, a1 to a6.
OXYGEN_LINES: Float[np.ndarray, "line 7"] = np.array(
    (
        (50.474214, 0.975, 9.651, 6.69, 0.0, 2.566, 6.85),
        (50.987745, 2.529, 8.653, 7.17, 0.0, 2.246, 6.8),
        (51.503360, 6.193, 7.709, 7.64, 0.0, 1.947, 6.729),
        (52.021429, 14.32, 6.819, 8.11, 0.0, 1.667, 6.64),
        (52.542418, 31.24, 5.983, 8.58, 0.0, 1.388, 6.526),
        (53.066934, 64.29, 5.201, 9.06, 0.0, 1.349, 6.206),
        (53.595775, 124.6, 4.474, 9.55, 0.0, 2.227, 5.085),
        (54.130025, 227.3, 3.8, 9.96, 0.0, 3.17, 3.75),
        (54.671180, 389.7, 3.182, 10.37, 0.0, 3.558, 2.654),
        (55.221384, 627.1, 2.618, 10.89, 0.0, 2.56, 2.952),
        (55.783815, 945.3, 2.109, 11.34, 0.0, -1.172, 6.135),
        (56.264774, 543.4, 0.014, 17.03, 0.0, 3.525, -0.978),
        (56.363399, 1331.8, 1.654, 11.89, 0.0, -2.378, 6.547),
        (56.968211, 1746.6, 1.255, 12.23, 0.0, -3.545, 6.451),
        (57.612486, 2120.1, 0.91, 12.62, 0.0, -5.416, 6.056),
        (58.323877, 2363.7, 0.621, 12.95, 0.0, -1.932, 0.436),
        (58.446588, 1442.1, 0.083, 14.91, 0.0, 6.768, -1.273),
        (59.164204, 2379.9, 0.387, 13.53, 0.0, -6.561, 2.309),
        (59.590983, 2090.7, 0.207, 14.08, 0.0, 6.957, -0.776),
        (60.306056, 2103.4, 0.207, 14.15, 0.0, -6.395, 0.699),
        (60.434778, 2438.0, 0.386, 13.39, 0.0, 6.342, -2.825),
        (61.150562, 2479.5, 0.621, 12.92, 0.0, 1.014, -0.584),
        (61.800158, 2275.9, 0.91, 12.63, 0.0, 5.014, -6.619),
        (62.411220, 1915.4, 1.255, 12.17, 0.0, 3.029, -6.759),
        (62.486253, 1503.0, 0.083, 15.13, 0.0, -4.499, 0.844),
        (62.997984, 1490.2, 1.654, 11.74, 0.0, 1.856, -6.675),
        (63.568526, 1078.0, 2.108, 11.34, 0.0, 0.658, -6.139),
        (64.127775, 728.7, 2.617, 10.88, 0.0, -3.036, -2.895),
        (64.678910, 461.3, 3.181, 10.38, 0.0, -3.968, -2.59),
        (65.224078, 274.0, 3.8, 9.96, 0.0, -3.528, -3.68),
        (65.764779, 153.0, 4.473, 9.55, 0.0, -2.548, -5.002),
        (66.302096, 80.4, 5.2, 9.06, 0.0, -1.66, -6.091),
        (66.836834, 39.8, 5.982, 8.58, 0.0, -1.68, -6.393),
        (67.369601, 18.56, 6.818, 8.11, 0.0, -1.956, -6.475),
        (67.900868, 8.172, 7.708, 7.64, 0.0, -2.216, -6.545),
        (68.431006, 3.397, 8.652, 7.17, 0.0, -2.492, -6.6),
        (68.960312, 1.334, 9.65, 6.69, 0.0, -2.773, -6.65),
        (118.750334, 940.3, 0.01, 16.64, 0.0, -0.439, 0.079),
        (368.498246, 67.4, 0.048, 16.4, 0.0, 0.0, 0.0),
        (424.763020, 637.7, 0.044, 16.4, 0.0, 0.0, 0.0),
        (487.249273, 237.4, 0.049, 16.0, 0.0, 0.0, 0.0),
        (715.392902, 98.1, 0.145, 16.0, 0.0, 0.0, 0.0),
        (773.839490, 572.3, 0.141, 16.2, 0.0, 0.0, 0.0),
        (834.145546, 183.1, 0.145, 14.7, 0.0, 0.0, 0.0),
    )
)

# Table 2: f0, b1 to b6; the last, beyond 1000 GHz, acts as a continuum below.
VAPOUR_LINES: Float[np.ndarray, "line 7"] = np.array(
    (
        (22.235080, 0.1079, 2.144, 26.38, 0.76, 5.087, 1.0),
        (67.803960, 0.0011, 8.732, 28.58, 0.69, 4.93, 0.82),
        (119.995940, 0.0007, 8.353, 29.48, 0.7, 4.78, 0.79),
        (183.310087, 2.273, 0.668, 29.06, 0.77, 5.022, 0.85),
        (321.225630, 0.047, 6.179, 24.04, 0.67, 4.398, 0.54),
        (325.152888, 1.514, 1.541, 28.23, 0.64, 4.893, 0.74),
        (336.227764, 0.001, 9.825, 26.93, 0.69, 4.74, 0.61),
        (380.197353, 11.67, 1.048, 28.11, 0.54, 5.063, 0.89),
        (390.134508, 0.0045, 7.347, 21.52, 0.63, 4.81, 0.55),
        (437.346667, 0.0632, 5.048, 18.45, 0.6, 4.23, 0.48),
        (439.150807, 0.9098, 3.595, 20.07, 0.63, 4.483, 0.52),
        (443.018343, 0.192, 5.048, 15.55, 0.6, 5.083, 0.5),
        (448.001085, 10.41, 1.405, 25.64, 0.66, 5.028, 0.67),
        (470.888999, 0.3254, 3.597, 21.34, 0.66, 4.506, 0.65),
        (474.689092, 1.26, 2.379, 23.2, 0.65, 4.804, 0.64),
        (488.490108, 0.2529, 2.852, 25.86, 0.69, 5.201, 0.72),
        (503.568532, 0.0372, 6.731, 16.12, 0.61, 3.98, 0.43),
        (504.482692, 0.0124, 6.731, 16.12, 0.61, 4.01, 0.45),
        (547.676440, 0.9785, 0.158, 26.0, 0.7, 4.5, 1.0),
        (552.020960, 0.184, 0.158, 26.0, 0.7, 4.5, 1.0),
        (556.935985, 497.0, 0.159, 30.86, 0.69, 4.552, 1.0),
        (620.700807, 5.015, 2.391, 24.38, 0.71, 4.856, 0.68),
        (645.766085, 0.0067, 8.633, 18.0, 0.6, 4.0, 0.5),
        (658.005280, 0.2732, 7.816, 32.1, 0.69, 4.14, 1.0),
        (752.033113, 243.4, 0.396, 30.86, 0.68, 4.352, 0.84),
        (841.051732, 0.0134, 8.177, 15.9, 0.33, 5.76, 0.45),
        (859.965698, 0.1325, 8.055, 30.6, 0.68, 4.09, 0.84),
        (899.303175, 0.0547, 7.914, 29.85, 0.68, 4.53, 0.9),
        (902.611085, 0.0386, 8.429, 28.65, 0.7, 5.1, 0.95),
        (906.205957, 0.1836, 5.11, 24.08, 0.7, 4.7, 0.53),
        (916.171582, 8.4, 1.441, 26.73, 0.7, 5.15, 0.78),
        (923.112692, 0.0079, 10.293, 29.0, 0.7, 5.0, 0.8),
        (970.315022, 9.009, 1.919, 25.5, 0.64, 4.94, 0.67),
        (987.926764, 134.6, 0.257, 29.85, 0.68, 4.55, 0.9),
        (1780.000000, 17506.0, 0.952, 196.3, 2.0, 24.15, 5.0),
    )
)


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
    # Line coupling of the overlapping lines: `mixing` skews their shapes.
    line, a1, a2, a3, a4, a5, a6 = OXYGEN_LINES.T
    p, e, theta = air.dry_pressure_hpa, air.vapour_pressure_hpa, air.theta
    strength = a1 * 1e-7 * p * theta**3 * np.exp(a2 * (1.0 - theta))
    width = np.sqrt((a3 * 1e-4 * (p * theta ** (0.8 - a4) + 1.1 * e * theta)) ** 2 + 2.25e-6)
    mixing = (a5 + a6 * theta) * 1e-4 * (p + e) * theta**0.8
    resonant = (width - mixing * (line - f)) / ((line - f) ** 2 + width**2)
    antiresonant = (width - mixing * (line + f)) / ((line + f) ** 2 + width**2)
    return float(np.sum(strength * f / line * (resonant + antiresonant)))


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
    # Like oxygen, without coupling; the width combines pressure and Doppler broadening.
    line, b1, b2, b3, b4, b5, b6 = VAPOUR_LINES.T
    p, e, theta = air.dry_pressure_hpa, air.vapour_pressure_hpa, air.theta
    strength = b1 * 0.1 * e * theta**3.5 * np.exp(b2 * (1.0 - theta))
    pressure_width = b3 * 1e-4 * (p * theta**b4 + b5 * e * theta**b6)
    width = 0.535 * pressure_width + np.sqrt(0.217 * pressure_width**2 + 2.1316e-12 * line**2 / theta)
    resonant = width / ((line - f) ** 2 + width**2)
    antiresonant = width / ((line + f) ** 2 + width**2)
    return float(np.sum(strength * f / line * (resonant + antiresonant)))
