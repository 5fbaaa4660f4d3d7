"""The film on a wet radome: its thickness against the balance of flow, its loss against limits and a measurement."""

import math

import pytest
from scipy.constants import g, speed_of_light

from sionna_radar.weather.path import VISCOSITY_M2_PER_S, film_thickness_m, film_transmission, wet_radome_loss_db
from sionna_radar.weather.permittivity import water_permittivity


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
