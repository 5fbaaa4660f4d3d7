"""Gaseous attenuation against the ITU's validation examples of P.676."""

import pytest

from sionna_radar.weather.gases import (
    Air,
    dry_air_attenuation_db_per_km,
    gas_attenuation_db_per_km,
    vapour_attenuation_db_per_km,
)
from sionna_radar.weather.validity import ValidityError

# ITU-Rpy, test/test_data/676/ITURP676-13_gamma.csv: GHz, dry and vapour part in dB/km, at 1013.25 hPa,
# 288.15 K and 7.5 g/m3.
P676_13 = [
    (12.0, 0.00869826406877357, 0.00953538822024593),
    (20.0, 0.0118835504778076, 0.0970473048151117),
    (60.0, 14.6234747964861, 0.15484184100000),
    (90.0, 0.0388697110724235, 0.34197339400000),
    (130.0, 0.0415090835995228, 0.75184470400000),
]
# ITURP676-12_gamma.csv in the same folder: the same conditions, same lines, nine digits.
P676_12 = [
    (1.0, 0.005388658, 5.09e-05),
    (50.0, 0.277268639, 0.111158547),
    (76.0, 0.109604316, 0.244230584),
    (77.0, 0.097525836, 0.250517679),
    (78.0, 0.087579282, 0.256921734),
    (81.0, 0.066378053, 0.276788451),
    (94.0, 0.034480723, 0.37364816),
    (119.0, 1.306379041, 0.61799348),
    (183.0, 0.012733909, 27.66500831),
    (250.0, 0.018753887, 3.077989748),
]


@pytest.mark.parametrize(("f_ghz", "dry", "vapour"), P676_13)
def test_matches_the_validation_examples_of_p676_13(f_ghz, dry, vapour):
    assert dry_air_attenuation_db_per_km(f_ghz * 1e9, Air()) == pytest.approx(dry, rel=1e-12)
    assert vapour_attenuation_db_per_km(f_ghz * 1e9, Air()) == pytest.approx(vapour, rel=5e-9)


@pytest.mark.parametrize(("f_ghz", "dry", "vapour"), P676_12)
def test_matches_the_validation_examples_of_p676_12(f_ghz, dry, vapour):
    assert dry_air_attenuation_db_per_km(f_ghz * 1e9, Air()) == pytest.approx(dry, abs=6e-10, rel=1e-8)
    assert vapour_attenuation_db_per_km(f_ghz * 1e9, Air()) == pytest.approx(vapour, abs=6e-10, rel=1e-3)
    if f_ghz > 1:
        assert vapour_attenuation_db_per_km(f_ghz * 1e9, Air()) == pytest.approx(vapour, rel=1e-8)


def test_the_parts_add_up_at_77_ghz():
    assert gas_attenuation_db_per_km(77e9, Air()) == pytest.approx(0.348043514, abs=1e-9)


def test_dry_air_has_no_vapour_and_no_air_takes_nothing():
    assert vapour_attenuation_db_per_km(77e9, Air(vapour_density_g_per_m3=0.0)) == 0.0
    assert gas_attenuation_db_per_km(77e9, Air(dry_pressure_pa=0.0, vapour_density_g_per_m3=0.0)) == 0.0


def test_impossible_air_is_refused():
    with pytest.raises(ValidityError, match="temperature_k"):
        Air(temperature_k=15.0)
    with pytest.raises(ValidityError, match="dry_pressure_pa"):
        Air(dry_pressure_pa=-1.0)
    with pytest.raises(ValidityError, match="frequency_hz"):
        gas_attenuation_db_per_km(2e12, Air())
