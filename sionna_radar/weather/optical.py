"""Extinction and backscatter of light in the air, at the wavelengths of lidars.

Extinction: Koschmieder, 3.912 / V at 550 nm for a contrast of 2 %, and toward the infrared (wavelength / 550 nm)^-q
with q by the visibility: Kim's for fog (none below 500 m), Kruse's for haze and smoke, none for dust, whose grains are
large. Rain and snow by the fits that ITU-R P.1814 and P.1817 recommend.
Backscatter = extinction / lidar ratio. Raindrops are so few in a beam that each is a separate
echo (`drop_backscatter_m2_per_sr`).

Sources. Kruse, McGlauchlin and McQuistan 1962, "Elements of Infrared Technology"; Kim, McArthur and Korevaar 2001,
Proc. SPIE 4214, 26-37; Pierce, Ramaprasad and Eisenberg 2001, Proc. SPIE 4530 (abstract read: fog is equal from the
visible to the near infrared, and Kruse's formula is for small particles); Carbonneau and Wisely 1998, Proc. SPIE 3232,
98-106. The formulas are as restated throughout the literature on optical links; the papers themselves were not at hand.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.weather.drops import ExponentialDrops, marshall_palmer
from sionna_radar.weather.validity import Obscurant, Precipitation, require_between, require_not_negative

SOURCE = "the optical weather models"
SHORTEST_NM, LONGEST_NM = 500.0, 1700.0
VISIBLE_NM = 550.0
KOSCHMIEDER = float(-np.log(0.02))
PER_M_OF_DB_PER_KM = float(np.log(10) / 10 / 1000)
# Carbonneau and Wisely 1998: dB/km, R in mm/h, the same at all optical wavelengths.
RAIN_DB_PER_KM, RAIN_EXPONENT = 1.076, 0.67
# ITU-R P.1814: a = slope times the wavelength in nm + offset, dB/km = a S^b, S in mm/h as water.
SNOW = {
    Precipitation.WET_SNOW: (1.023e-4, 3.7855466, 0.72),
    Precipitation.DRY_SNOW: (5.42e-5, 5.4958776, 1.38),
}
# Extinction over backscatter, sr. Droplets: O'Connor, Illingworth and Hogan 2004 (J. Atmos. Oceanic Technol. 21,
# 777-786), 18.8 at 905 nm. The others are typical values at 1064 nm: dust 40 to 55, smoke 50 to 70, polluted haze 30 to
# 60, ice crystals 20 to 30.
LIDAR_RATIO_SR = {Obscurant.FOG: 18.8, Obscurant.HAZE: 45.0, Obscurant.DUST: 50.0, Obscurant.SMOKE: 60.0}
SNOW_LIDAR_RATIO_SR = 25.0
WATER_INDEX = 1.32
# Absorption of light in water (1/m), wavelength in nm: Hale and Querry 1973 (Appl. Opt. 12, 555-563), rounded.
WATER_ABSORPTION_NM = np.array([500.0, 800.0, 905.0, 1064.0, 1300.0, 1550.0, 1700.0])
WATER_ABSORPTION_PER_M = np.array([0.03, 2.0, 7.0, 15.0, 120.0, 1000.0, 600.0])


def fog_exponent(visibility_m: float) -> float:
    """Return Kim's exponent of the wavelength in fog and haze of a visibility."""
    km = visibility_m / 1000
    if km > 50:
        return 1.6
    if km > 6:
        return 1.3
    if km > 1:
        return 0.16 * km + 0.34
    return max(km - 0.5, 0.0)


def haze_exponent(visibility_m: float) -> float:
    """Return Kruse's exponent of the wavelength, for particles smaller than it."""
    km = visibility_m / 1000
    if km > 50:
        return 1.6
    return 1.3 if km > 6 else 0.585 * km ** (1 / 3)


def obscurant_extinction_per_m(kind: Obscurant, visibility_m: float, wavelength_nm: float) -> float:
    """Return the extinction of suspended particles, given the visibility in them alone."""
    exponent = {
        Obscurant.FOG: fog_exponent,
        Obscurant.HAZE: haze_exponent,
        Obscurant.SMOKE: haze_exponent,
        Obscurant.DUST: lambda _: 0.0,
    }[kind](visibility_m)
    return float(KOSCHMIEDER / visibility_m * (wavelength_nm / VISIBLE_NM) ** -exponent)


def rain_extinction_per_m(rain_rate_mm_per_h: float) -> float:
    """Return the extinction of rain."""
    require_not_negative("rain_rate_mm_per_h", rain_rate_mm_per_h)
    return float(PER_M_OF_DB_PER_KM * RAIN_DB_PER_KM * rain_rate_mm_per_h**RAIN_EXPONENT)


def snow_extinction_per_m(kind: Precipitation, snowfall_mm_per_h: float, wavelength_nm: float) -> float:
    """Return the extinction of snowfall."""
    require_not_negative("snowfall_mm_per_h", snowfall_mm_per_h)
    slope, offset, exponent = SNOW[kind]
    return float(PER_M_OF_DB_PER_KM * (slope * wavelength_nm + offset) * snowfall_mm_per_h**exponent)


def drop_backscatter_m2_per_sr(
    diameter_m: Float[np.ndarray, " drop"], wavelength_nm: float
) -> Float[np.ndarray, " drop"]:
    """Return the backscatter of raindrops per steradian: the glints of the near and the far face.

    Geometrical optics of a sphere of radius a: R a^2 / 4 from the near face, R the normal reflection, and from the
    far one R (1 - R)^2 (n / (2 - n))^2 a^2 / 4, after two passes through the water, which at 1550 nm absorbs most of it
    in drops of a millimetre. The glory is neglected: flattened drops of many wavelengths have none.
    """
    reflectance = ((WATER_INDEX - 1) / (WATER_INDEX + 1)) ** 2
    absorption_per_m = np.interp(wavelength_nm, WATER_ABSORPTION_NM, WATER_ABSORPTION_PER_M)
    through = (
        (1 - reflectance) ** 2 * (WATER_INDEX / (2 - WATER_INDEX)) ** 2 * np.exp(-2 * absorption_per_m * diameter_m)
    )
    return reflectance * (1 + through) * (diameter_m / 2) ** 2 / 4


@dataclass(frozen=True, kw_only=True)
class OpticalAir:
    """The air as seen by a lidar, uniform in space.

    backscatter_per_m_sr: of everything but rain, whose drops are separate echoes.
    drops: of rain; None without rain.
    """

    wavelength_nm: float
    extinction_per_m: float
    backscatter_per_m_sr: float
    drops: ExponentialDrops | None


def optical_air(
    wavelength_nm: float,
    *,
    rain_rate_mm_per_h: float = 0.0,
    snowfall_mm_per_h: Mapping[Precipitation, float] | None = None,
    visibility_m: Mapping[Obscurant, float] | None = None,
) -> OpticalAir:
    """Return the optical properties of the air; extinctions add up, and so do backscatters."""
    require_between("wavelength_nm", wavelength_nm, SHORTEST_NM, LONGEST_NM, SOURCE)
    extinction, backscatter = rain_extinction_per_m(rain_rate_mm_per_h), 0.0
    for kind, range_m in (visibility_m or {}).items():
        extinction_part = obscurant_extinction_per_m(kind, range_m, wavelength_nm)
        extinction, backscatter = extinction + extinction_part, backscatter + extinction_part / LIDAR_RATIO_SR[kind]
    for snow, rate in (snowfall_mm_per_h or {}).items():
        extinction_part = snow_extinction_per_m(snow, rate, wavelength_nm)
        extinction, backscatter = extinction + extinction_part, backscatter + extinction_part / SNOW_LIDAR_RATIO_SR
    return OpticalAir(
        wavelength_nm=wavelength_nm,
        extinction_per_m=extinction,
        backscatter_per_m_sr=backscatter,
        drops=marshall_palmer(rain_rate_mm_per_h) if rain_rate_mm_per_h > 0 else None,
    )
