"""The radar cross-section of spheres against published amplitudes and limits: miepython's conventions are ours."""

import math

import numpy as np
import pytest

from sionna_radar.weather.scattering import mie_backscatter


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
