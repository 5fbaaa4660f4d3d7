"""The permittivity of water against a second published fit to the measurements, and its symmetry."""

import pytest

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
