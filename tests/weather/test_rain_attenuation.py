"""Rain attenuation against Table 5 of ITU-R P.838-3 and the ITU's validation examples."""

import math

import pytest

from sionna_radar.weather.rain import rain_attenuation_db_per_km, rain_power_law
from sionna_radar.weather.validity import ValidityError

# P.838-3 Table 5: f in GHz, k_H, alpha_H, k_V, alpha_V (read in pycomlink, processing/k_R_relation.py).
TABLE_5 = [
    (1.0, 0.0000259, 0.9691, 0.0000308, 0.8592),
    (10.0, 0.01217, 1.2571, 0.01129, 1.2156),
    (30.0, 0.2403, 0.9485, 0.2291, 0.9129),
    (60.0, 0.8606, 0.7656, 0.8515, 0.7486),
    (76.0, 1.1185, 0.7199, 1.1139, 0.7091),
    (77.0, 1.1320, 0.7177, 1.1276, 0.7073),
    (78.0, 1.1451, 0.7156, 1.1410, 0.7055),
    (80.0, 1.1704, 0.7115, 1.1668, 0.7021),
    (100.0, 1.3671, 0.6815, 1.3680, 0.6765),
]
# ITU validation examples (ITU-Rpy, test/test_data/838): elevation deg, GHz, mm/h, tilt deg, k, alpha, dB/km.
VALIDATION = [
    (31.07699124, 14.25, 26.48052, 0.0, 0.03975488, 1.12418043, 1.58130839),
    (46.35969261, 29.0, 27.13586832, 0.0, 0.21978097, 0.9484851, 5.03135479),
    (85.80459566, 14.25, 99.13558978, 90.0, 0.04133039, 1.09499629, 6.34064598),
    (20.14335809, 29.0, 42.91007183, 90.0, 0.21298877, 0.92265917, 6.83364556),
]


@pytest.mark.parametrize(("f_ghz", "k_h", "alpha_h", "k_v", "alpha_v"), TABLE_5)
def test_the_fit_reproduces_table_5(f_ghz, k_h, alpha_h, k_v, alpha_v):
    horizontal = rain_power_law(f_ghz * 1e9, elevation_rad=0.0, tilt_rad=0.0)
    vertical = rain_power_law(f_ghz * 1e9, elevation_rad=0.0, tilt_rad=math.pi / 2)
    # Rounding of the table's last digit; k at 1 GHz has three digits only.
    assert horizontal.k == pytest.approx(k_h, rel=2e-3 if f_ghz == 1.0 else 3e-4)
    assert vertical.k == pytest.approx(k_v, rel=2e-3 if f_ghz == 1.0 else 3e-4)
    assert horizontal.alpha == pytest.approx(alpha_h, abs=6e-5)
    assert vertical.alpha == pytest.approx(alpha_v, abs=6e-5)


@pytest.mark.parametrize(("elevation", "f_ghz", "rate", "tilt", "k", "alpha", "gamma"), VALIDATION)
def test_oblique_paths_match_the_itu_validation_examples(elevation, f_ghz, rate, tilt, k, alpha, gamma):
    angles = {"elevation_rad": math.radians(elevation), "tilt_rad": math.radians(tilt)}
    law = rain_power_law(f_ghz * 1e9, **angles)
    assert law.k == pytest.approx(k, rel=1e-6)
    assert law.alpha == pytest.approx(alpha, rel=1e-7)
    found = rain_attenuation_db_per_km(f_ghz * 1e9, rain_rate_mm_per_h=rate, **angles)
    assert found == pytest.approx(gamma, rel=1e-8)


def test_seen_from_straight_above_polarization_does_not_matter():
    laws = [rain_power_law(77e9, elevation_rad=-math.pi / 2, tilt_rad=t) for t in (0.0, 0.7, math.pi / 2)]
    assert laws[0] == laws[1] == laws[2]


def test_no_rain_takes_nothing_and_more_rain_takes_more():
    rates = (0.0, 1.0, 10.0, 100.0)
    found = [
        rain_attenuation_db_per_km(77e9, rain_rate_mm_per_h=rate, elevation_rad=0.0, tilt_rad=0.0) for rate in rates
    ]
    assert found[0] == 0.0
    assert sorted(found) == found


def test_a_frequency_beyond_the_recommendation_is_refused():
    with pytest.raises(ValidityError, match="frequency_hz"):
        rain_power_law(0.5e9, elevation_rad=0.0, tilt_rad=0.0)
    with pytest.raises(ValidityError, match="rain_rate"):
        rain_attenuation_db_per_km(77e9, rain_rate_mm_per_h=-1.0, elevation_rad=0.0, tilt_rad=0.0)
