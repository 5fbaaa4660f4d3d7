"""Fog attenuation against the ITU's validation examples of P.840 and against Rayleigh absorption."""

import math

import pytest
from scipy.constants import speed_of_light

from sionna_radar.weather.obscurants import FogClass, fog_attenuation_db_per_km, fog_coefficient
from sionna_radar.weather.permittivity import water_permittivity
from sionna_radar.weather.validity import ValidityError

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


def test_fog_is_linear_in_its_water():
    thick = fog_attenuation_db_per_km(
        77e9, liquid_water_g_per_m3=FogClass.THICK.liquid_water_g_per_m3, temperature_k=278.15
    )
    medium = fog_attenuation_db_per_km(
        77e9, liquid_water_g_per_m3=FogClass.MEDIUM.liquid_water_g_per_m3, temperature_k=278.15
    )
    assert thick == pytest.approx(10 * medium, rel=1e-12)
    assert fog_attenuation_db_per_km(77e9, liquid_water_g_per_m3=0.0, temperature_k=278.15) == 0.0


def test_what_the_model_was_not_made_for_is_refused():
    with pytest.raises(ValidityError, match="frequency_hz"):
        fog_coefficient(300e9, 283.15)
    with pytest.raises(ValidityError, match="liquid_water"):
        fog_attenuation_db_per_km(77e9, liquid_water_g_per_m3=-0.1, temperature_k=283.15)
