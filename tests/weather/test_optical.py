"""Light through weather, against the sources' formulas and published figures."""

import numpy as np
import pytest

from sionna_radar.weather.optical import (
    drop_backscatter_m2_per_sr,
    fog_exponent,
    haze_exponent,
    obscurant_extinction_per_m,
    optical_air,
    rain_extinction_per_m,
    snow_extinction_per_m,
)
from sionna_radar.weather.validity import Obscurant, Precipitation, ValidityError

DB_PER_KM = 1000 * 10 / np.log(10)


def test_the_visibility_leaves_two_percent_of_the_light_at_550_nm():
    for kind in Obscurant:
        assert np.exp(-300 * obscurant_extinction_per_m(kind, 300.0, 550.0)) == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("visibility_km", "wavelength_nm", "db_per_km"),
    # Kim, McArthur and Korevaar 2001, table of attenuation against visibility at 785 and 1550 nm; Koschmieder's 17 dB.
    [(0.05, 785.0, 340), (0.05, 1550.0, 340), (0.2, 785.0, 85), (1.0, 785.0, 14), (1.0, 1550.0, 10)],
)
def test_fog_attenuates_as_kim_tabulates(visibility_km, wavelength_nm, db_per_km):
    found = DB_PER_KM * obscurant_extinction_per_m(Obscurant.FOG, 1000 * visibility_km, wavelength_nm)
    assert found == pytest.approx(db_per_km, rel=0.03)


def test_exponents_are_continuous_and_kims_fades_in_fog():
    assert [fog_exponent(v) for v in (100.0, 499.0)] == [0.0, 0.0]
    for at in (500.0, 1000.0, 6000.0):
        assert fog_exponent(at * (1 - 1e-9)) == pytest.approx(fog_exponent(at * (1 + 1e-9)), abs=1e-6)
    # Kruse: 0.585 * 1.817 = 1.06 meets 1.3 in a step, as published.
    assert haze_exponent(1000.0) == pytest.approx(0.585)
    assert haze_exponent(60e3) == 1.6
    smoke, dust = (
        [obscurant_extinction_per_m(kind, 200.0, w) for w in (905.0, 1550.0)]
        for kind in (Obscurant.SMOKE, Obscurant.DUST)
    )
    assert smoke[1] < smoke[0]
    assert dust[1] == dust[0]


def test_rain_and_snow_are_the_recommended_fits():
    assert DB_PER_KM * rain_extinction_per_m(25.0) == pytest.approx(1.076 * 25**0.67)
    assert rain_extinction_per_m(0.0) == 0.0
    # P.1814 at 1550 nm: dry snow of 1 mm/h 5.58, wet 3.94 dB/km.
    assert DB_PER_KM * snow_extinction_per_m(Precipitation.DRY_SNOW, 1.0, 1550.0) == pytest.approx(5.580, abs=1e-3)
    assert DB_PER_KM * snow_extinction_per_m(Precipitation.WET_SNOW, 1.0, 1550.0) == pytest.approx(3.944, abs=1e-3)


def test_a_drops_two_glints():
    """The near face of a sphere is a mirror of radius a: R a^2 / 4; water at 1550 nm swallows the far one's."""
    diameter = np.array([1e-3, 4e-3])
    near = ((1.32 - 1) / (1.32 + 1)) ** 2 * (diameter / 2) ** 2 / 4
    at_905, at_1550 = (drop_backscatter_m2_per_sr(diameter, w) for w in (905.0, 1550.0))
    np.testing.assert_allclose(at_905 / near, 4.6, rtol=0.05)
    assert 1.0 < at_1550[1] / near[1] < 1.01
    assert 1.2 < at_1550[0] / near[0] < 2


def test_what_fills_the_air_adds_up():
    kinds = {Obscurant.FOG: 500.0, Obscurant.DUST: 1000.0}
    air = optical_air(905.0, rain_rate_mm_per_h=10.0, visibility_m=kinds)
    fog, dust = (obscurant_extinction_per_m(k, v, 905.0) for k, v in kinds.items())
    assert air.extinction_per_m == pytest.approx(fog + dust + rain_extinction_per_m(10.0))
    assert air.backscatter_per_m_sr == pytest.approx(fog / 18.8 + dust / 50)
    clear = optical_air(1550.0)
    assert (clear.extinction_per_m, clear.backscatter_per_m_sr, clear.drops) == (0.0, 0.0, None)
    with pytest.raises(ValidityError, match="wavelength_nm = 10600"):
        optical_air(10600.0)
