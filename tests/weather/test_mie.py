"""Mie efficiencies against published ones and against their limits."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sionna_radar.weather.scattering import mie_efficiencies


def efficiencies(index, size):
    found = mie_efficiencies(np.array([size], dtype=float), complex(index))
    return found.extinction[0], found.scattering[0], found.backscatter[0]


# Bohren and Huffman's sample run and miepython's variants of it (scottprahl/miepython, tests/test_mie.py:
# test_03_bh_dielectric, test_04_non_dielectric, test_09_single_nonmagnetic; sign of k by our convention).
SPHERE = 2 * math.pi * 0.525 / 0.6328
PUBLISHED = [
    (1.55, SPHERE, 3.10543, 3.10543, 2.92534, 1e-5),
    (1.55 + 0.1j, SPHERE, 2.86165188243, 1.66424911991, 0.20599534080, 1e-7),
    (1.5 + 0.5j, 2.5, 2.562873497454734, 1.097071819088392, 0.123586468179818, 1e-7),
]
# Wiscombe's MIEV0 test cases 12 to 15 and 9, 10, 17, 18, by the same file: extinction and scattering.
WISCOMBE_EXTINCTION = [
    (1.5 + 1j, 0.055, 0.101491),
    (1.5 + 1j, 0.056, 0.1033467),
    (1.5 + 1j, 1.0, 2.336321),
    (1.5 + 1j, 100.0, 2.097502),
]
WISCOMBE_SCATTERING = [
    (1.33 + 1e-5j, 1.0, 0.093923),
    (1.33 + 1e-5j, 100.0, 2.096594),
    (1.5 + 1j, 1.0, 0.6634538),
    (0.75, 10.0, 2.232265),
    (10 + 10j, 1.0, 2.049405),
    (10 + 10j, 100.0, 1.836785),
]
# The amplitude S1 straight back (MIEV0 cases 7 and 5, and case 14 of the angular test): Q_b = |2 S1/x|^2.
WISCOMBE_BACK = [
    (0.75, 10.0, -1.07857e00 - 3.60881e-02j),
    (0.75, 0.099, 1.81756e-8 - 1.64810e-4j),
    (1.5 + 1j, 1.0, 0.348844 + 0.146829j),
]


@pytest.mark.parametrize(("index", "size", "extinction", "scattering", "back", "tolerance"), PUBLISHED)
def test_all_three_efficiencies_of_published_spheres(index, size, extinction, scattering, back, tolerance):
    assert efficiencies(index, size) == pytest.approx((extinction, scattering, back), abs=tolerance)


@pytest.mark.parametrize(("index", "size", "extinction"), WISCOMBE_EXTINCTION)
def test_extinction_of_wiscombe_cases(index, size, extinction):
    assert efficiencies(index, size)[0] == pytest.approx(extinction, abs=1e-6)


@pytest.mark.parametrize(("index", "size", "scattering"), WISCOMBE_SCATTERING)
def test_scattering_of_wiscombe_cases(index, size, scattering):
    assert efficiencies(index, size)[1] == pytest.approx(scattering, abs=1e-6)


@pytest.mark.parametrize(("index", "size", "amplitude"), WISCOMBE_BACK)
def test_backscatter_of_wiscombe_cases(index, size, amplitude):
    assert efficiencies(index, size)[2] == pytest.approx(abs(2 * amplitude / size) ** 2, rel=2e-5)


def test_a_small_drop_is_a_rayleigh_scatterer():
    index, size = 3.5 + 2.0j, 1e-3
    polarizability = (index**2 - 1) / (index**2 + 2)
    extinction, scattering, back = efficiencies(index, size)
    assert extinction == pytest.approx(4 * size * polarizability.imag, rel=1e-5)
    assert scattering == pytest.approx(8 / 3 * size**4 * abs(polarizability) ** 2, rel=1e-4)
    assert back == pytest.approx(4 * size**4 * abs(polarizability) ** 2, rel=1e-4)


def test_a_large_good_conductor_echoes_like_its_shadow():
    # Radar's metal sphere has pi a^2; a water-like sphere has |Fresnel at normal incidence|^2 pi a^2.
    index = 100 + 100j
    assert efficiencies(index, 200.0)[2] == pytest.approx(abs((index - 1) / (index + 1)) ** 2, rel=0.02)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.01, 30.0), st.floats(1.1, 9.0), st.floats(0.0, 5.0))
def test_no_sphere_scatters_more_than_it_removes(size, real, imaginary):
    extinction, scattering, back = efficiencies(complex(real, imaginary), size)
    assert back >= 0
    assert scattering <= extinction * (1 + 1e-6)


def test_a_sphere_does_not_depend_on_its_company():
    sizes = np.array([0.002, 0.3, 25.0])
    together = mie_efficiencies(sizes, 3.0 + 1.5j)
    for i, size in enumerate(sizes):
        alone = mie_efficiencies(np.array([size]), 3.0 + 1.5j)
        assert together.extinction[i] == pytest.approx(alone.extinction[0], rel=1e-12)
        assert together.backscatter[i] == pytest.approx(alone.backscatter[0], rel=1e-12)
