"""Attenuation and echo of fog, haze, dust and smoke, given by visibility or liquid water.

Koschmieder: at the visibility V 2 % of the contrast is left, so the optical extinction is 3.912 / V. The mass of the
particles follows from it by a measured relation, and their size from both: a mass M of spheres much larger than light's
wavelength has the extinction 3 M / (2 density r_e), r_e their effective radius (mean r^3 over mean r^2). At radar
wavelengths the attenuation depends on the mass alone; the echo depends on the size, and is 30 dB or more below that of
light rain.
"""

import math

from sionna_radar.weather.fog import (
    CONTRAST,
    liquid_water_of_visibility_g_per_m3,
    visibility_of_liquid_water_m,
)
from sionna_radar.weather.permittivity import water_permittivity
from sionna_radar.weather.scattering import Aerosol
from sionna_radar.weather.validity import Obscurant, require_between, require_not_negative

SOURCE = "the model of haze, dust and smoke"
LOWEST_FREQUENCY_HZ = 10e9
HIGHEST_FREQUENCY_HZ = 150e9
WATER_G_PER_M3 = 1e6

# Fog droplets follow D^4 exp(-D/D0) in four advection fogs (de Wolf et al. 1999, J. Appl. Meteor. 38, 126-133, read in
# the introduction), for which mean r^6 / mean r^3 = 720/343 r_e^3.
FOG_ECHO = (720.0 / 343.0) ** (1 / 3)

# Dust: 23 mg/m3 at 1 km, growing as V^-1.07 (Goldhirsh 1982, IEEE Trans. AP-30, 1121-1127, after storms measured by
# Patterson and Gillette 1977). From memory of the literature; the size that follows, 3 to 4 um, lies within the 0.6 to
# 20 um that the latter observed (abstract read). Chepil and Woodruff 1957 have 56 mg/m3 and V^-1.25, which is
# 2.4 times as much at 1 km and 3.7 times at 100 m; far from its source dust extinguishes 0.64 m2/g (over Athens,
# abstract read), which is 6 mg/m3 at 1 km. Hence a storm's attenuation is uncertain by a factor of four.
DUST_AT_1_KM_G_PER_M3 = 23e-3
DUST_EXPONENT = -1.07
DUST_DENSITY_G_PER_M3 = 2.65e6  # quartz
# Permittivity of dust by GHz, real part and loss, as tabulated in reviews of radio links in dust storms (after Sharif).
# From memory of the literature. It is natural dust with its moisture; dry quartz sand has a tenth of the loss.
DUST_PERMITTIVITY = (
    (10.0, 5.73 + 0.415j),
    (14.0, 5.5 + 1.3j),
    (24.0, 5.1 + 1.4j),
    (37.0, 4.0 + 1.325j),
    (94.0, 3.5 + 1.64j),
)
# Assumption: log-normal sizes with a geometric standard deviation of 2 (between 1.6 and 2.5 the echo changes by -7 and
# +11 dB); then mean r^6 / mean r^3 = r_e^3 exp(6 s^2), s = log 2.
DUST_ECHO = math.exp(2.0 * math.log(2.0) ** 2)

# Haze and smoke: mass from the mass extinction. Dry sulphates extinguish 1.5 to 4 m2/g, nitrates 2.5 to 3,
# organics 1.8 to 4.7 (a textbook's table, read); wildfire smoke scatters 3.3 to 7.4 m2/g (Oregon 2021, abstract read).
HAZE_M2_PER_G = 3.0
SMOKE_M2_PER_G = 5.0
# Assumption: haze is swollen by moisture, so it is taken as pure water, which has the greatest loss.
HAZE_G_PER_M3 = WATER_G_PER_M3
# Assumption: no measurements of smoke at millimetre wavelengths were found. If all of it were the best possible
# absorber, (eps - 1)/(eps + 2) = 1.5i, the attenuation would be 19 times larger.
SMOKE_PERMITTIVITY = 4.0 + 1.0j
SMOKE_DENSITY_G_PER_M3 = 1.3e6
# Assumption: fine particles of 0.3 um, whose echo (-140 dB m2/m3 and less) is never detectable.
FINE_ECHO_RADIUS_M = 0.3e-6


def optical_extinction_per_m(visibility_m: float) -> float:
    """Return the extinction of visible light for a visibility: 3.912 / V (Koschmieder, 2 % of contrast)."""
    return -math.log(CONTRAST) / visibility_m


def dust_mass_g_per_m3(visibility_m: float) -> float:
    """Return the mass of dust in a cubic metre of air (Goldhirsh 1982)."""
    return float(DUST_AT_1_KM_G_PER_M3 * (visibility_m / 1000.0) ** DUST_EXPONENT)


def effective_radius_m(mass_g_per_m3: float, visibility_m: float, density_g_per_m3: float) -> float:
    """Return the mean r^3 over the mean r^2 of particles with a given mass and visibility."""
    return 1.5 * mass_g_per_m3 / (density_g_per_m3 * optical_extinction_per_m(visibility_m))


def fog_droplets(
    frequency_hz: float, *, liquid_water_g_per_m3: float, visibility_m: float | None, temperature_k: float
) -> Aerosol:
    """Return the droplets of a fog; the default visibility is that of a mean fog with its water (Kunkel 1984)."""
    require_not_negative("liquid_water_g_per_m3", liquid_water_g_per_m3)
    seen_m = visibility_of_liquid_water_m(liquid_water_g_per_m3) if visibility_m is None else visibility_m
    radius_m = effective_radius_m(liquid_water_g_per_m3, seen_m, WATER_G_PER_M3)
    return Aerosol(
        permittivity=water_permittivity(frequency_hz, temperature_k),
        volume_fraction=liquid_water_g_per_m3 / WATER_G_PER_M3,
        echo_radius_m=FOG_ECHO * radius_m,
    )


def obscurant(kind: Obscurant, frequency_hz: float, *, visibility_m: float, temperature_k: float) -> Aerosol:
    """Return the particles of fog, haze, dust or smoke, given the visibility in them alone."""
    if kind is Obscurant.FOG:
        water = liquid_water_of_visibility_g_per_m3(visibility_m)
        return fog_droplets(
            frequency_hz, liquid_water_g_per_m3=water, visibility_m=visibility_m, temperature_k=temperature_k
        )
    require_between("frequency_hz", frequency_hz, LOWEST_FREQUENCY_HZ, HIGHEST_FREQUENCY_HZ, SOURCE)
    if kind is Obscurant.DUST:
        mass = dust_mass_g_per_m3(visibility_m)
        return Aerosol(
            permittivity=dust_permittivity(frequency_hz),
            volume_fraction=mass / DUST_DENSITY_G_PER_M3,
            echo_radius_m=DUST_ECHO * effective_radius_m(mass, visibility_m, DUST_DENSITY_G_PER_M3),
        )
    extinction = optical_extinction_per_m(visibility_m)
    if kind is Obscurant.HAZE:
        return Aerosol(
            permittivity=water_permittivity(frequency_hz, temperature_k),
            volume_fraction=extinction / HAZE_M2_PER_G / HAZE_G_PER_M3,
            echo_radius_m=FINE_ECHO_RADIUS_M,
        )
    return Aerosol(
        permittivity=SMOKE_PERMITTIVITY,
        volume_fraction=extinction / SMOKE_M2_PER_G / SMOKE_DENSITY_G_PER_M3,
        echo_radius_m=FINE_ECHO_RADIUS_M,
    )


def dust_permittivity(frequency_hz: float) -> complex:
    """Return the relative permittivity of dust grains, interpolated in the logarithm of frequency."""
    x = math.log(frequency_hz / 1e9)
    (lower_ghz, lower), *rows = DUST_PERMITTIVITY
    for upper_ghz, upper in rows:
        if x <= math.log(upper_ghz):
            weight = max(x - math.log(lower_ghz), 0.0) / math.log(upper_ghz / lower_ghz)
            return lower + weight * (upper - lower)
        lower_ghz, lower = upper_ghz, upper
    return lower
