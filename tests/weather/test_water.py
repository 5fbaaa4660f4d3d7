"""Water: its permittivity against a second published fit, and the film of it on a wet radome."""

import math

import pytest
from scipy.constants import g, speed_of_light

from sionna_radar.weather.path import VISCOSITY_M2_PER_S, film_thickness_m, film_transmission, wet_radome_loss_db
from sionna_radar.weather.permittivity import water_permittivity
from sionna_radar.weather.validity import ValidityError


def single_debye(frequency_ghz, temperature_c):
    # Liebe, Hufford and Manabe 1991, the one-term model for frequencies up to 100 GHz
    # (restated at reef.atmos.colostate.edu/~odell/at721/resources/codes/fortran/eps_swd_l91.f90).
    theta = 1 - 300 / (273.15 + temperature_c)
    static = 77.66 - 103.3 * theta
    high = 0.066 * static
    relaxation_ghz = 20.27 + 146.5 * theta + 314.0 * theta**2
    return (static - high) / (1 - 1j * frequency_ghz / relaxation_ghz) + high


@pytest.mark.parametrize("frequency_ghz", [1.0, 10.0, 35.0, 77.0, 94.0])
@pytest.mark.parametrize("temperature_c", [0.0, 10.0, 20.0, 30.0])
def test_agrees_with_the_one_term_fit_of_the_same_authors(frequency_ghz, temperature_c):
    # Two fits of the same measurements: they part by 6 % at most, in cold water at the highest frequency.
    found = water_permittivity(frequency_ghz * 1e9, temperature_c + 273.15)
    expected = single_debye(frequency_ghz, temperature_c)
    assert abs(found - expected) < 0.06 * abs(expected)


def test_water_absorbs_and_stiffens_with_frequency():
    values = [water_permittivity(f * 1e9, 283.15) for f in (1.0, 10.0, 77.0, 300.0, 1000.0)]
    assert all(value.imag > 0 for value in values)
    assert [v.real for v in values] == sorted((v.real for v in values), reverse=True)


def test_ice_and_steam_are_refused():
    for temperature_k in (230.0, 373.15):
        with pytest.raises(ValidityError, match="temperature_k"):
            water_permittivity(77e9, temperature_k)


@pytest.mark.parametrize("angle_deg", [10.0, 50.0, 89.0])
def test_as_much_water_runs_off_as_falls_on(angle_deg):
    radius_m, rate_m_per_s = 0.2, 20.0 / 3.6e6
    sine = math.sin(math.radians(angle_deg))
    caught = math.pi * (radius_m * sine) ** 2 * rate_m_per_s
    film = film_thickness_m(20.0, radius_m)
    running = g * sine * film**3 / (3 * VISCOSITY_M2_PER_S) * 2 * math.pi * radius_m * sine
    assert running == pytest.approx(caught, rel=1e-12)


def test_a_dry_radome_loses_nothing_and_a_thick_film_all_but_its_two_faces():
    assert wet_radome_loss_db(77e9, rain_rate_mm_per_h=0.0, radius_m=0.2, temperature_k=283.15) == pytest.approx(0.0)
    index = water_permittivity(77e9, 283.15) ** 0.5
    depth = 2 * math.pi * 77e9 / speed_of_light * index.imag
    thick_m = 2e-3
    faces = abs(4 * index / (1 + index) ** 2) ** 2
    passed = film_transmission(77e9, thickness_m=thick_m, temperature_k=283.15)
    assert passed == pytest.approx(faces * math.exp(-2 * depth * thick_m), rel=1e-3)


def test_a_thin_film_is_a_sheet_of_small_admittance():
    # |t|^2 = 1 - k d Im(eps) to first order in the thickness.
    thin_m = 1e-8
    loss = 2 * math.pi * 77e9 / speed_of_light * thin_m * water_permittivity(77e9, 283.15).imag
    assert 1 - film_transmission(77e9, thickness_m=thin_m, temperature_k=283.15) == pytest.approx(loss, rel=1e-2)


def test_the_film_is_an_upper_bound_of_a_weather_radars_radome():
    """Kurri and Huuskonen 2008 (abstract): C band, 6.7 m across, dirty: 3 dB both ways at 15.1 mm/h, 0.7 of it dry."""
    loss_db = wet_radome_loss_db(5.6e9, rain_rate_mm_per_h=15.1, radius_m=3.35, temperature_k=283.15)
    assert 3.0 - 0.7 < loss_db < 2.5 * (3.0 - 0.7)
