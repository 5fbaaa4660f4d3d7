"""Echoes of spheres and spheroids against published amplitudes, Mie, Rayleigh and T-matrix results."""

import math

import numpy as np
import pytest

from sionna_radar.weather.drops import ANGLES_RAD, axis_ratio, drop_polarization, marshall_palmer
from sionna_radar.weather.rain import rain_attenuations_db_per_km
from sionna_radar.weather.scattering import mie_backscatter, spheroid_echo


def back(index, size):
    return mie_backscatter(np.array([size], dtype=float), complex(index))[0]


# The amplitude S1 straight back (Wiscombe's MIEV0, cases 7 and 5, and case 14 of the angular test): |2 S1 / x|^2.
@pytest.mark.parametrize(
    ("index", "size", "amplitude"),
    [
        (0.75, 10.0, -1.07857e00 - 3.60881e-02j),
        (0.75, 0.099, 1.81756e-8 - 1.64810e-4j),
        (1.5 + 1j, 1.0, 0.348844 + 0.146829j),
    ],
)
def test_backscatter_of_wiscombe_cases(index, size, amplitude):
    assert back(index, size) == pytest.approx(abs(2 * amplitude / size) ** 2, rel=2e-5)


def test_bohren_and_huffmans_sphere_absorbs_with_a_positive_imaginary_part():
    assert back(1.55 + 0.1j, 2 * math.pi * 0.525 / 0.6328) == pytest.approx(0.20599534080, abs=1e-7)


def test_a_small_drop_is_a_rayleigh_scatterer():
    index, size = 3.5 + 2.0j, 1e-3
    polarizability = (index**2 - 1) / (index**2 + 2)
    assert back(index, size) == pytest.approx(4 * size**4 * abs(polarizability) ** 2, rel=1e-4)


def test_a_large_good_conductor_echoes_like_its_shadow():
    # Radar's metal sphere has pi a^2; a water-like sphere has |Fresnel at normal incidence|^2 pi a^2.
    index = 100 + 100j
    assert back(index, 200.0) == pytest.approx(abs((index - 1) / (index + 1)) ** 2, rel=0.02)


WATER_77 = np.sqrt(7.9 + 13.2j)
RIGHT, V, H = np.array([1, 1j]) / np.sqrt(2), np.array([1.0, 0.0]), np.array([0.0, 1.0])


@pytest.mark.parametrize("size", [0.1, 1.0, 3.0, 5.0])
def test_a_sphere_is_mies_from_any_side(size):
    echo = spheroid_echo(size, 1.0, WATER_77, np.deg2rad([10.0, 60.0, 90.0]))
    np.testing.assert_allclose(echo.vertical, echo.horizontal, rtol=1e-6)
    efficiency = mie_backscatter(np.array([size]), WATER_77)[0]
    np.testing.assert_allclose(4 * np.abs(echo.vertical) ** 2 / size**2, efficiency, rtol=1e-6)


def test_a_small_spheroid_is_rayleighs():
    """Polarizability along each axis by its depolarization factor; seen at t from the axis V mixes both."""
    ratio, look = 0.7, np.deg2rad([30.0, 90.0])
    e2 = 1 - ratio**2
    along = (1 - np.sqrt(1 - e2) / np.sqrt(e2) * np.arcsin(np.sqrt(e2))) / e2
    across = (1 - along) / 2
    a, b = ((WATER_77**2 - 1) / (1 + factor * (WATER_77**2 - 1)) for factor in (along, across))
    echo = spheroid_echo(0.01, ratio, WATER_77, look)
    expected = (a * np.sin(look) ** 2 + b * np.cos(look) ** 2) / b
    np.testing.assert_allclose(echo.vertical / echo.horizontal, expected, rtol=0.01)


# Amplitudes (mm) of V and H seen from the side at a wavelength of 3.893 mm, by the T-matrix code rustmatrix 2.1.1 (a
# port of Mishchenko's); diameter in mm, axis ratio. Its H counts the other way round.
T_MATRIX = [
    (1.0, 0.98, 2.74042220e-01 + 1.26922762e-01j, 2.77401462e-01 + 1.35811282e-01j),
    (2.0, 0.93, 1.15556967e-01 + 1.62344918e-02j, 1.15542707e-01 - 5.17183032e-03j),
    (3.0, 0.87, 4.55127966e-03 - 5.68674101e-01j, 7.03905557e-02 - 5.14893009e-01j),
    (4.0, 0.80, -5.38775013e-01 + 5.01644864e-01j, -6.72764059e-01 + 3.40060906e-01j),
]


@pytest.mark.parametrize(("diameter_mm", "ratio", "vertical", "horizontal"), T_MATRIX)
def test_drops_of_some_wavelengths_are_those_of_the_t_matrix(diameter_mm, ratio, vertical, horizontal):
    echo = spheroid_echo(np.pi * diameter_mm / 3.893, ratio, WATER_77, np.array([np.pi / 2]))
    found = np.concatenate([echo.vertical, echo.horizontal]) * 3.893 / (2 * np.pi)
    np.testing.assert_allclose(found, [vertical, horizontal], atol=2e-4 * abs(vertical))


def test_drops_flatten_as_they_grow():
    assert axis_ratio(np.array([0.3e-3]))[0] == pytest.approx(1.0, abs=1e-3)
    # Pruppacher and Beard 1970: 1.03 - 0.62 D (cm) from 1 to 9 mm.
    diameter = np.array([2e-3, 3e-3, 4e-3, 5e-3])
    np.testing.assert_allclose(axis_ratio(diameter), 1.03 - 62 * diameter, atol=0.035)


def ratio_db(frequency_hz, rate, angle_deg, sent, received) -> float:
    rain = drop_polarization(frequency_hz, marshall_palmer(rate), 288.15)
    angle = np.deg2rad([angle_deg])
    return float(10 * np.log10(rain.power(angle, sent[None], received[None]))[0])


def test_same_sense_rain_grows_from_above_to_the_side_and_with_the_rate():
    levels = [ratio_db(77e9, 4.0, angle, RIGHT, RIGHT) for angle in (0, 20, 45, 70, 90)]
    assert np.all(np.diff(levels) > 0.5)
    assert levels[0] < -55
    # Side-on the axis ratio rules alone, and sin^4 of the angle scales it: -12 dB of power at 30 deg.
    assert ratio_db(77e9, 4.0, 30, RIGHT, RIGHT) - levels[-1] == pytest.approx(-12.0, abs=2.0)
    assert ratio_db(77e9, 25.0, 45, RIGHT, RIGHT) > levels[2] + 3
    # X band weighs the large drops: some 20 dB less rejection, as weather radars find (cancellation of 15 to 25 dB).
    assert -25 < ratio_db(10e9, 25.0, 80, RIGHT, RIGHT) < -15


def test_polarizations_of_rain_obey_what_they_must():
    """Reciprocity, symmetry straight down, and a sphere's ports."""
    assert ratio_db(77e9, 4.0, 60, V, H) == pytest.approx(ratio_db(77e9, 4.0, 60, H, V), abs=1e-9)
    rain = drop_polarization(77e9, marshall_palmer(4.0), 288.15)
    assert rain.upright[0] == pytest.approx(rain.slanted[0], rel=0.1)
    assert abs(rain.mean[0]) < 1e-9
    assert np.all(rain.upright >= rain.slanted * (1 - 1e-9))
    assert rain.angle_rad is ANGLES_RAD
    # LDR of canted drops: |D|^2 sin^2 2a; with 7 deg, E sin^2 2a is 0.056, 12.5 dB under the same-sense return.
    assert ratio_db(77e9, 4.0, 90, V, H) - ratio_db(77e9, 4.0, 90, RIGHT, RIGHT) == pytest.approx(-12.5, abs=0.3)
    assert ratio_db(77e9, 4.0, 60, RIGHT, RIGHT.conj()) == pytest.approx(0.0, abs=1e-9)
    assert ratio_db(77e9, 4.0, 90, H, H) > 0 > ratio_db(77e9, 4.0, 90, V, V)


def test_the_way_through_the_rain_turns_little():
    """Differential loss over 100 m and back: tanh of half of it in nepers is the field in the other sense."""
    v, h = rain_attenuations_db_per_km(77e9, rain_rate_mm_per_h=25.0, mix=np.array([-1.0, 1.0]))
    nepers = (h - v) * 0.2 * np.log(10) / 20
    assert 20 * np.log10(np.tanh(nepers / 2)) < -45
