"""Fog, haze, dust and smoke: Rayleigh's limits, the ITU's examples of P.840, and mass, visibility and echo."""

import math

import numpy as np
import pytest
from miepython import efficiencies_mx
from scipy.constants import speed_of_light

from sionna_radar.weather.fog import (
    FogClass,
    fog_attenuation_db_per_km,
    fog_coefficient,
    liquid_water_of_visibility_g_per_m3,
    visibility_of_liquid_water_m,
)
from sionna_radar.weather.obscurants import (
    DUST_DENSITY_G_PER_M3,
    dust_mass_g_per_m3,
    dust_permittivity,
    effective_radius_m,
    fog_droplets,
    obscurant,
    optical_extinction_per_m,
)
from sionna_radar.weather.permittivity import water_permittivity
from sionna_radar.weather.rain import rain_reflectivity_per_m
from sionna_radar.weather.scattering import Aerosol
from sionna_radar.weather.validity import Obscurant, ValidityError


def particles(kind, frequency_hz, visibility_m):
    return obscurant(kind, frequency_hz, visibility_m=visibility_m, temperature_k=283.15)


@pytest.mark.parametrize("frequency_hz", [10e9, 77e9, 150e9])
def test_small_spheres_are_those_of_mie(frequency_hz):
    permittivity, radius_m, count_per_m3 = 3.5 + 1.6j, 20e-6, 1e6
    cloud = Aerosol(
        permittivity=permittivity, volume_fraction=count_per_m3 * 4 / 3 * math.pi * radius_m**3, echo_radius_m=radius_m
    )
    size = np.array([2 * math.pi * radius_m * frequency_hz / speed_of_light])
    extinction, _, back, _ = efficiencies_mx(np.conj(permittivity**0.5), size)
    area = count_per_m3 * math.pi * radius_m**2
    assert cloud.attenuation_db_per_km(frequency_hz) == pytest.approx(4342.945 * area * extinction[0], rel=0.01)
    assert cloud.reflectivity_per_m(frequency_hz) == pytest.approx(area * back[0], rel=0.01)


def test_fog_takes_what_p840_says():
    fog = particles(Obscurant.FOG, 77e9, 100.0)
    water = liquid_water_of_visibility_g_per_m3(100.0)
    expected = fog_attenuation_db_per_km(77e9, liquid_water_g_per_m3=water, temperature_k=283.15)
    assert fog.attenuation_db_per_km(77e9) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("fog", FogClass)
def test_kunkels_fogs_are_those_of_the_itu(fog):
    water = liquid_water_of_visibility_g_per_m3(fog.visibility_m)
    assert water == pytest.approx(fog.liquid_water_g_per_m3, rel=0.33)
    assert visibility_of_liquid_water_m(water) == pytest.approx(fog.visibility_m, rel=1e-12)


def test_thick_fog_echoes_as_clouds_do_and_thin_fog_more():
    """Atlas 1954 (J. Meteor. 11, 309): Z = 0.048 M^2 mm6/m3 in clouds, M in g/m3 (coefficients from memory).

    In fogs Z is nearer to linear in M than to its square (de Wolf et al. 1999, introduction read).
    """

    def factor(water):
        fog = fog_droplets(10e9, liquid_water_g_per_m3=water, visibility_m=None, temperature_k=283.15)
        assert 5e-6 < fog.echo_radius_m < 20e-6
        return 48 / math.pi * fog.volume_fraction * fog.echo_radius_m**3 * 1e18  # (6/pi) 2^3 = 48/pi

    assert 10 * math.log10(factor(0.5) / (0.048 * 0.5**2)) == pytest.approx(0.0, abs=2.0)
    assert 1.0 < math.log(factor(0.5) / factor(0.05)) / math.log(10.0) < 1.5


@pytest.mark.parametrize("visibility_m", [50.0, 500.0, 5000.0])
def test_mass_and_size_of_dust_leave_its_visibility(visibility_m):
    mass = dust_mass_g_per_m3(visibility_m)
    radius_m = effective_radius_m(mass, visibility_m, DUST_DENSITY_G_PER_M3)
    assert 0.62e-6 < radius_m < 20e-6  # Patterson, Gillette and Grams: the sizes that are seen
    # Large spheres extinguish twice their area, 3 M / (4 density r) of it in a cubic metre.
    seen = 2 * 3 * mass / (4 * DUST_DENSITY_G_PER_M3 * radius_m)
    assert seen == pytest.approx(optical_extinction_per_m(visibility_m), rel=1e-12)
    assert optical_extinction_per_m(visibility_m) * visibility_m == pytest.approx(3.912, abs=1e-3)


def test_dust_echoes_less_than_a_light_rain():
    """Goldhirsh 2001 (abstract): at X band a storm seen through for 2 m echoes less than rain of 0.6 mm/h."""
    storm = obscurant(Obscurant.DUST, 10e9, visibility_m=2.0, temperature_k=288.15).reflectivity_per_m(10e9)
    assert storm < rain_reflectivity_per_m(10e9, rain_rate_mm_per_h=0.6, temperature_k=288.15)


def test_dust_of_100_m_takes_some_tenths_of_a_decibel_at_77_ghz():
    assert 0.1 < particles(Obscurant.DUST, 77e9, 100.0).attenuation_db_per_km(77e9) < 1.0
    ghz = [10.0, 14.0, 24.0, 37.0, 94.0]
    assert dust_permittivity(24e9) == pytest.approx(5.1 + 1.4j)
    between = [dust_permittivity(f * 1e9) for f in np.linspace(10, 150, 50)]
    assert min(e.real for e in between) == pytest.approx(3.5)
    assert all(dust_permittivity(f * 1e9).imag > 0 for f in ghz)


@pytest.mark.parametrize("kind", [Obscurant.HAZE, Obscurant.SMOKE])
def test_haze_and_smoke_are_computed_and_negligible(kind):
    thick = particles(kind, 77e9, 100.0)
    assert 0 < thick.attenuation_db_per_km(77e9) < 0.1
    assert 0 < thick.reflectivity_per_m(77e9) < 1e-13
    thin = particles(kind, 77e9, 1000.0)
    assert thick.attenuation_db_per_km(77e9) == pytest.approx(10 * thin.attenuation_db_per_km(77e9), rel=1e-9)


@pytest.mark.parametrize("kind", [Obscurant.HAZE, Obscurant.DUST, Obscurant.SMOKE])
def test_obscurants_beyond_their_band_are_refused(kind):
    with pytest.raises(ValidityError, match="frequency_hz"):
        particles(kind, 200e9, 100.0)


# ITU validation examples of P.840-8 (ITU-Rpy, test/test_data/840): GHz, elevation in deg, attenuation in dB,
# and the columnar liquid water (kg/m2, at 0 deg C) of the same place and time share; K_l = A sin(el) / L.
VALIDATION = [
    (14.25, 31.07699124, 0.59136662, 1.641289077),
    (29.0, 31.07699124, 2.3028307, 1.641289077),
    (14.25, 40.232036, 0.36114732, 1.254176128),
    (29.0, 40.232036, 1.40633765, 1.254176128),
    (14.25, 46.35969261, 0.2872291, 1.117630129),
    (29.0, 46.35969261, 1.11849396, 1.117630129),
]


@pytest.mark.parametrize(("f_ghz", "elevation", "attenuation_db", "liquid_kg_per_m2"), VALIDATION)
def test_coefficient_matches_the_itu_validation_examples(f_ghz, elevation, attenuation_db, liquid_kg_per_m2):
    expected = attenuation_db * math.sin(math.radians(elevation)) / liquid_kg_per_m2
    assert fog_coefficient(f_ghz * 1e9, 273.15) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("frequency_hz", [10e9, 77e9, 150e9])
def test_is_the_absorption_of_rayleigh_droplets(frequency_hz):
    # Q_abs = 4 x Im K summed over droplets of 1 g/m3 in all: 6 pi Im K / lambda times the volume of 1e-6.
    # At 77 GHz this also shows the coefficient right beyond the frequencies of the ITU's examples.
    permittivity = water_permittivity(frequency_hz, 278.15)
    factor = (permittivity - 1) / (permittivity + 2)
    per_m = 6 * math.pi * factor.imag * frequency_hz / speed_of_light * 1e-6
    expected = 10 * math.log10(math.e) * 1000 * per_m
    assert fog_coefficient(frequency_hz, 278.15) == pytest.approx(expected, rel=1e-3)


def test_what_the_model_was_not_made_for_is_refused():
    with pytest.raises(ValidityError, match="frequency_hz"):
        fog_coefficient(300e9, 283.15)
    with pytest.raises(ValidityError, match="liquid_water"):
        fog_attenuation_db_per_km(77e9, liquid_water_g_per_m3=-0.1, temperature_k=283.15)
