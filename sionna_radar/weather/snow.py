"""Falling snow: attenuation and backscatter, 10 to 150 GHz.

Dry snow is computed from its flakes. A sphere of the flake's mean density is a poor model at millimetre wavelengths:
front and back cancel, and at 94 GHz and 4 mm/h its echo is 12 dB below that of the model here, which agrees with
relations for cloud radars (tests show both). The flakes are therefore taken as aggregates, with similar structure on
all scales: the self-similar Rayleigh-Gans approximation of Hogan and Westbrook 2014.

Wet snow cannot be computed this way: water spread over a flake or collected in drops differs tenfold in attenuation.
Its attenuation is that of rain with the same water, times the maximum factor of the ITU's melting layer. Its echo is
that of the flakes, half molten.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.foundation.numerics import gauss_legendre
from sionna_radar.weather.drops import EchoSpeeds, fall_speed_mps, weighted_speeds
from sionna_radar.weather.permittivity import ICE_DENSITY_KG_PER_M3, MELTING_K, ice_permittivity, water_permittivity
from sionna_radar.weather.permittivity import WATER_DENSITY_KG_PER_M3 as WATER_KG_PER_M3
from sionna_radar.weather.rain import rain_attenuation_db_per_km
from sionna_radar.weather.scattering import DB_PER_KM_PER_NEPER_PER_M, clausius_mossotti
from sionna_radar.weather.validity import Precipitation, ValidityError, require_between

SOURCE = "the model of falling snow"
LOWEST_FREQUENCY_HZ = 10e9
HIGHEST_FREQUENCY_HZ = 150e9
# Sekhon and Srivastava 1970 (J. Atmos. Sci. 27, 299-307), from its abstract: flakes by their melted diameter D follow
# N0 exp(-L D), N0 = 2500 R^-0.94 per mm and m3, L = 22.9 R^-0.45 per cm, R in mm/h of water.
INTERCEPT_PER_M4 = 2.5e6
INTERCEPT_EXPONENT = -0.94
SLOPE_PER_M = 2290.0
SLOPE_EXPONENT = -0.45
# The same paper's Z = 1780 R^2.21 mm6/m3 (as tabulated in the literature notes of mgrover1/sail-xprecip-radar) is a
# third of the untruncated distribution's 5450 R^2.21. The paper discusses truncation; the cut at L D = 5.8, where both
# agree, is our inference.
LARGEST = 5.8
# Brandes et al. 2007 (J. Appl. Meteor. Climatol. 46, 634-650), Colorado: 0.178 D^-0.922 g/cm3, D in mm the diameter of
# the sphere with the flake's volume. Read in J. Tiira's snowfall scripts beside other laws, five of which (Holroyd
# 1971, Schaller 1982, Muramoto 1995, Fabry 1999, Heymsfield 2004) give 0.5 to 0.9 of it at 4 mm, 0.3 to 1.0 at 1 mm.
FLAKE_DENSITY_KG_PER_M3 = 178.0
FLAKE_DENSITY_EXPONENT = -0.922
# Locatelli and Hobbs 1974 (J. Geophys. Res. 79, 2185-2197): aggregates of unrimed dendrites fall with 0.8 D^0.16 m/s, D
# in mm. From memory of the literature; with it the flux of Sekhon and Srivastava's flakes, untruncated, is 1.10 to 0.97
# times their rate of 0.25 to 8 mm/h (a test), so the two are consistent.
FALL_MPS = 0.8
FALL_EXPONENT = 0.16
# Hogan and Westbrook 2014 (J. Atmos. Sci. 71, 3292-3301), their synthetic aggregates: from memory of the literature.
KAPPA = 0.19  # kurtosis of the mass along the beam
BETA = 0.23  # power of the fluctuations around the mean
GAMMA = 5.0 / 3.0  # slope of their spectrum
HARMONICS = 60
# Assumed for wet snow: half of its mass is water (from none to all the echo changes by 5 to 7 dB), and its
# speed is 13 % of the way from a flake's to a drop's, Mitra et al. 1990 as restated by Szyrmer and Zawadzki 1999 (from
# memory).
MOLTEN = 0.5
FASTER = 0.246 * MOLTEN + (1 - 0.246) * MOLTEN**7
# The maximum of the melting-layer factor of ITU-R P.2001-2, attachment C.4, and P.530 (`melting_factor`).
WETTEST_M = -240.6
NODES = 120
ANGLES = 48


def melting_factor(above_melting_level_m: float) -> float:
    """Return the specific attenuation of melting snow over that of the rain it becomes, by height (0 to -1200 m).

    Source: ITU-R P.2001-2, attachment C.4, as coded by I. Stevanovic (multi_layer.m); the same as in P.530. P.2001 is
    valid up to 50 GHz; beyond, it is an extrapolation.
    """
    require_between("above_melting_level_m", above_melting_level_m, -1200.0, 0.0, "ITU-R P.2001-2, attachment C.4")
    rising = 4.0 * (1.0 - math.exp(above_melting_level_m / 70.0)) ** 2
    falling = (1.0 - math.exp(-((above_melting_level_m / 600.0) ** 2))) ** 2
    return rising / (1.0 + falling * (rising - 1.0))


@dataclass(frozen=True, kw_only=True)
class Flakes:
    """Snowflakes of all sizes in a cubic metre of air.

    count_per_m3: of each node of size; mass_kg, diameter_m (of the sphere of equal volume), speed_mps: of one flake.
    """

    count_per_m3: Float[np.ndarray, " node"]
    mass_kg: Float[np.ndarray, " node"]
    diameter_m: Float[np.ndarray, " node"]
    speed_mps: Float[np.ndarray, " node"]

    @property
    def rate_mm_per_h(self) -> float:
        """Snowfall rate as water."""
        return float(np.sum(self.count_per_m3 * self.mass_kg * self.speed_mps)) / WATER_KG_PER_M3 * 3.6e6


def flakes(snowfall_mm_per_h: float, kind: Precipitation) -> Flakes:
    """Return the flakes of a snowfall: sizes from Sekhon and Srivastava 1970, number from the snowfall rate."""
    if not snowfall_mm_per_h > 0:
        raise ValidityError(f"snowfall_mm_per_h = {snowfall_mm_per_h:g} must be positive")
    raw = sekhon_srivastava(snowfall_mm_per_h, kind, largest=LARGEST)
    return replace(raw, count_per_m3=snowfall_mm_per_h / raw.rate_mm_per_h * raw.count_per_m3)


def sekhon_srivastava(snowfall_mm_per_h: float, kind: Precipitation, *, largest: float) -> Flakes:
    """Return the flakes of a snowfall with the number densities of Sekhon and Srivastava 1970."""
    slope_per_m = SLOPE_PER_M * snowfall_mm_per_h**SLOPE_EXPONENT
    intercept_per_m4 = INTERCEPT_PER_M4 * snowfall_mm_per_h**INTERCEPT_EXPONENT
    nodes, weights = gauss_legendre(NODES)
    half_span_m = largest / slope_per_m / 2.0
    melted_m = half_span_m * (1.0 + nodes)
    diameter_m = _flake_diameter_m(melted_m)
    dry_mps = FALL_MPS * (1e3 * diameter_m) ** FALL_EXPONENT
    wet = kind is Precipitation.WET_SNOW
    return Flakes(
        count_per_m3=half_span_m * weights * intercept_per_m4 * np.exp(-slope_per_m * melted_m),
        mass_kg=WATER_KG_PER_M3 * np.pi / 6.0 * melted_m**3,
        diameter_m=diameter_m,
        speed_mps=dry_mps + FASTER * np.maximum(fall_speed_mps(melted_m) - dry_mps, 0.0) if wet else dry_mps,
    )


def _flake_diameter_m(melted_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    # density(D) D^3 = density of water times melted^3, and no flake is denser than ice.
    ratio = WATER_KG_PER_M3 / FLAKE_DENSITY_KG_PER_M3
    fluffy_mm = (ratio * (1e3 * melted_m) ** 3) ** (1.0 / (3.0 + FLAKE_DENSITY_EXPONENT))
    return np.maximum(1e-3 * fluffy_mm, melted_m * np.cbrt(WATER_KG_PER_M3 / ICE_DENSITY_KG_PER_M3))


def form_factor(phase: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Return the echo of an aggregate over that of the same mass at a point.

    phase: wave number times extent along the beam. Hogan and Westbrook 2014, eq. 12: the mean shape, and the
    fluctuations around it. 1 for a flake far smaller than the wavelength.
    """
    x2, pi = 2.0 * phase, np.pi
    mean = np.cos(phase) * (
        (1 + KAPPA / 3) * (1 / (x2 + pi) - 1 / (x2 - pi)) - KAPPA * (1 / (x2 + 3 * pi) - 1 / (x2 - 3 * pi))
    )
    rough = np.zeros_like(phase)
    for j in range(1, HARMONICS + 1):
        rough += (2.0 * j) ** -GAMMA * (1 / (x2 + 2 * pi * j) ** 2 + 1 / (x2 - 2 * pi * j) ** 2)
    return pi**2 / 4 * (mean**2 + BETA * np.sin(phase) ** 2 * rough)


def _polarizability(frequency_hz: float, kind: Precipitation, temperature_k: float) -> complex:
    """Return the polarizability of a flake relative to a sphere of its melted volume: the sum over its parts."""
    ice = clausius_mossotti(ice_permittivity(frequency_hz, min(temperature_k, MELTING_K)))
    frozen = ice * WATER_KG_PER_M3 / ICE_DENSITY_KG_PER_M3
    if kind is Precipitation.DRY_SNOW:
        return frozen
    water = clausius_mossotti(water_permittivity(frequency_hz, MELTING_K))
    return (1.0 - MOLTEN) * frozen + MOLTEN * water


def _backscatter_m2(
    frequency_hz: float, falling: Flakes, polarizability: complex, size: float | Float[np.ndarray, "angle 1"] = 1.0
) -> Float[np.ndarray, "*shape node"]:
    wave_number = 2.0 * np.pi * frequency_hz / speed_of_light
    volume_m3 = falling.mass_kg / WATER_KG_PER_M3
    point_m2 = 9.0 / (4.0 * np.pi) * wave_number**4 * abs(polarizability) ** 2 * volume_m3**2
    return point_m2 * form_factor(size * wave_number * falling.diameter_m)


def snow_reflectivity_per_m(
    frequency_hz: float, *, snowfall_mm_per_h: float, kind: Precipitation, temperature_k: float
) -> float:
    """Return the radar cross-section of a cubic metre of snowfall (m2/m3)."""
    require_between("frequency_hz", frequency_hz, LOWEST_FREQUENCY_HZ, HIGHEST_FREQUENCY_HZ, SOURCE)
    falling = flakes(snowfall_mm_per_h, kind)
    polarizability = _polarizability(frequency_hz, kind, temperature_k)
    return float(np.sum(falling.count_per_m3 * _backscatter_m2(frequency_hz, falling, polarizability)))


def snow_attenuation_db_per_km(
    frequency_hz: float, *, snowfall_mm_per_h: float, kind: Precipitation, temperature_k: float
) -> float:
    """Return the one-way specific attenuation of snowfall.

    Dry: absorption by the ice, and scattering by the flakes in all directions. Wet: that of rain (ITU-R P.838) times
    the maximum `melting_factor`, 3.5; the mean over the layer is 1.9.
    """
    require_between("frequency_hz", frequency_hz, LOWEST_FREQUENCY_HZ, HIGHEST_FREQUENCY_HZ, SOURCE)
    if kind is Precipitation.WET_SNOW:
        rain = rain_attenuation_db_per_km(
            frequency_hz, rain_rate_mm_per_h=snowfall_mm_per_h, elevation_rad=0.0, tilt_rad=math.pi / 4
        )
        return melting_factor(WETTEST_M) * rain
    falling = flakes(snowfall_mm_per_h, kind)
    polarizability = _polarizability(frequency_hz, kind, temperature_k)
    absorbed_m2 = 6 * np.pi * frequency_hz / speed_of_light * polarizability.imag * falling.mass_kg / WATER_KG_PER_M3
    # For a scattering angle t, the phase is that of backscatter from an extent scaled by sin(t / 2).
    cosine, weight = gauss_legendre(ANGLES)
    size = np.sqrt((1.0 - cosine) / 2.0)[:, None]
    scattered_m2 = (weight * (1.0 + cosine**2) / 4.0) @ _backscatter_m2(frequency_hz, falling, polarizability, size)
    return DB_PER_KM_PER_NEPER_PER_M * float(np.sum(falling.count_per_m3 * (absorbed_m2 + scattered_m2)))


def snow_speeds(
    frequency_hz: float, *, snowfall_mm_per_h: float, kind: Precipitation, temperature_k: float
) -> EchoSpeeds:
    """Return the echo-weighted fall speeds of the flakes."""
    falling = flakes(snowfall_mm_per_h, kind)
    echo_m2 = _backscatter_m2(frequency_hz, falling, _polarizability(frequency_hz, kind, temperature_k))
    return weighted_speeds(falling.count_per_m3 * echo_m2, falling.speed_mps)
