"""Rain: what it removes and sends back, against P.838-3, the ITU's examples and measurements; and rain by place."""

import math

import numpy as np
import pytest
from miepython import efficiencies_mx
from scipy.constants import speed_of_light
from scipy.integrate import trapezoid

from sionna_radar.weather import rain
from sionna_radar.weather.conditions import NonUniformVolume, UniformVolume, Weather, volume_of
from sionna_radar.weather.drops import ExponentialDrops, marshall_palmer
from sionna_radar.weather.permittivity import water_permittivity
from sionna_radar.weather.rain import (
    CombinedRain,
    RainCell,
    RainField,
    drop_reflectivity_per_m,
    rain_attenuation_db_per_km,
    rain_power_law,
    rain_reflectivity_per_m,
)
from sionna_radar.weather.validity import Precipitation, ValidityError

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


def test_a_frequency_beyond_the_recommendation_is_refused():
    with pytest.raises(ValidityError, match="frequency_hz"):
        rain_power_law(0.5e9, elevation_rad=0.0, tilt_rad=0.0)
    with pytest.raises(ValidityError, match="rain_rate"):
        rain_attenuation_db_per_km(77e9, rain_rate_mm_per_h=-1.0, elevation_rad=0.0, tilt_rad=0.0)


TEMPERATURE_K = 283.15


def dielectric_factor(frequency_hz):
    permittivity = water_permittivity(frequency_hz, TEMPERATURE_K)
    return abs((permittivity - 1) / (permittivity + 2)) ** 2


def scattered_attenuation_db_per_km(frequency_hz, drops):
    """What the drops' extinction takes away."""
    diameter_m = np.linspace(1e-6, 20 / drops.slope_per_m, 2001)
    index = np.conj(water_permittivity(frequency_hz, TEMPERATURE_K) ** 0.5)
    extinction = efficiencies_mx(index, np.pi * diameter_m * frequency_hz / speed_of_light)[0]
    area = trapezoid(drops.density_per_m4(diameter_m) * np.pi / 4 * diameter_m**2 * extinction, diameter_m)
    return 4342.945 * area


def equivalent_reflectivity_dbz(eta_per_m, frequency_hz):
    wavelength_m = speed_of_light / frequency_hz
    z_m3 = eta_per_m * wavelength_m**4 / (math.pi**5 * dielectric_factor(frequency_hz))
    return 10 * math.log10(z_m3 * 1e18)


@pytest.mark.parametrize("rate", [3.0, 5.0, 7.0, 10.0])
def test_a_w_band_radar_sees_19_dbz_at_250_m(rate):
    # Hogan et al. 2003 (J. Atmos. Oceanic Technol. 20, 572, abstract): 94/95 GHz, 250 m, 3 to 10 mm/h, nearly
    # constant 19 dBZ for the loss on the way included; natural spread about 1.5 dB.
    eta_per_m = rain_reflectivity_per_m(94e9, rain_rate_mm_per_h=rate, temperature_k=TEMPERATURE_K)
    loss_db = 2 * 0.25 * scattered_attenuation_db_per_km(94e9, marshall_palmer(rate))
    assert equivalent_reflectivity_dbz(eta_per_m, 94e9) - loss_db == pytest.approx(19.0, abs=1.5)


@pytest.mark.parametrize("rate", [1.0, 5.0, 25.0, 50.0])
def test_mie_extinction_agrees_with_p838(rate):
    # P.838 stands for other mean drops, which are flattened too; Marshall-Palmer's carry more water than
    # their rain rate (below). The band is 1.3 dB wide upwards, as one rain differs from another.
    law = rain_attenuation_db_per_km(77e9, rain_rate_mm_per_h=rate, elevation_rad=0.0, tilt_rad=math.pi / 4)
    drops = scattered_attenuation_db_per_km(77e9, marshall_palmer(rate))
    assert 0.9 < drops / law < 1.35


def test_drizzle_at_low_frequency_is_rayleigh():
    # eta = pi^5 |K|^2 / lambda^4 * integral of N D^6 = 720 N0 / L^7.
    drops = ExponentialDrops(intercept_per_m4=8e6, slope_per_m=40_000.0)
    wavelength_m = speed_of_light / 3e9
    sixth_moment_m3 = 720 * drops.intercept_per_m4 / drops.slope_per_m**7
    expected = math.pi**5 * dielectric_factor(3e9) / wavelength_m**4 * sixth_moment_m3
    found = drop_reflectivity_per_m(3e9, drops=drops, temperature_k=TEMPERATURE_K)
    assert found == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("rate", [0.1, 10.0, 150.0])
def test_the_quadrature_has_converged(rate, monkeypatch):
    arguments = {"rain_rate_mm_per_h": rate, "temperature_k": TEMPERATURE_K}
    found = rain_reflectivity_per_m(77e9, **arguments)
    monkeypatch.setattr(rain, "NODES", 500)
    monkeypatch.setattr(rain, "MEAN_DIAMETERS", 30.0)
    assert found == pytest.approx(rain_reflectivity_per_m(77e9, **arguments), rel=1e-4)


def test_marshall_palmer_drops_carry_roughly_their_rain_rate():
    # Fall speed 9.65 - 10.3 exp(-0.6 D/mm) m/s (Atlas et al. 1973, eq. 24, doi 10.1029/RG011i001p00001, as
    # restated in several disdrometer codes). The excess of 16 % is that of Marshall and Palmer's fit.
    rate = 10.0
    drops = marshall_palmer(rate)
    diameter_m = np.linspace(1e-4, 8e-3, 4000)
    speed_mps = np.clip(9.65 - 10.3 * np.exp(-600.0 * diameter_m), 0, None)
    flux_mps = trapezoid(drops.density_per_m4(diameter_m) * math.pi / 6 * diameter_m**3 * speed_mps, diameter_m)
    assert flux_mps * 3.6e6 == pytest.approx(1.16 * rate, rel=0.02)


def test_no_rain_is_silent_and_less_than_none_is_refused():
    assert rain_reflectivity_per_m(77e9, rain_rate_mm_per_h=0.0, temperature_k=TEMPERATURE_K) == 0.0
    with pytest.raises(ValidityError, match="rain_rate"):
        rain_reflectivity_per_m(77e9, rain_rate_mm_per_h=-1.0, temperature_k=TEMPERATURE_K)
    with pytest.raises(ValidityError, match="rain_rate"):
        marshall_palmer(0.0)


def test_a_shower_falls_off_exponentially_and_holds_its_water():
    cell = RainCell(centre_m=(100.0, -50.0), radius_m=300.0, peak_mm_per_h=40.0)
    places = np.array([[100.0, -50.0], [400.0, -50.0], [100.0, -650.0]])
    np.testing.assert_allclose(cell.rate_mm_per_h(places), 40.0 * np.exp([0.0, -1.0, -2.0]))
    x = np.linspace(-6000, 6000, 1201)
    grid = np.stack(np.meshgrid(x, x), axis=-1)
    water = cell.rate_mm_per_h(grid).sum() * 100.0
    assert water == pytest.approx(2 * np.pi * 300.0**2 * 40.0, rel=1e-3)


def test_a_field_keeps_its_mean_its_spread_and_its_correlation():
    fields = [RainField(mean_mm_per_h=6.0, correlation_m=50.0, spread_db=3.0, seed=seed) for seed in range(8)]
    x = np.arange(0.0, 50.0 * 32, 12.5)
    grid = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1)
    rates = np.stack([field.rate_mm_per_h(grid) for field in fields])
    level_db = 10 * np.log10(rates)
    level_db -= level_db.mean()
    # Some 8 * 32^2 / (2 pi) independent patches: the mean of the logarithm is known to 0.1 dB.
    assert rates.mean() == pytest.approx(6.0, rel=0.05)
    assert level_db.std() == pytest.approx(3.0, rel=0.05)
    for lag in (1, 4, 8):
        correlation = np.mean(level_db * np.roll(level_db, lag, axis=1)) / level_db.var()
        assert correlation == pytest.approx(np.exp(-lag / 4), abs=0.06)


def test_a_field_is_its_seeds_and_has_no_seams():
    one, same, other = (RainField(mean_mm_per_h=5.0, correlation_m=40.0, spread_db=2.0, seed=s) for s in (3, 3, 4))
    places = np.random.default_rng(1).uniform(-3000, 3000, (200, 2))
    np.testing.assert_array_equal(one.rate_mm_per_h(places), same.rate_mm_per_h(places))
    assert not np.allclose(one.rate_mm_per_h(places), other.rate_mm_per_h(places))
    np.testing.assert_allclose(one.rate_mm_per_h(places), one.rate_mm_per_h(places + 40.0 * 32), rtol=1e-9)
    step = np.abs(np.diff(one.rate_mm_per_h(np.stack([np.arange(-100.0, 100.0, 0.01), np.zeros(20_000)], axis=1))))
    assert step.max() < 0.05


def test_rain_without_spread_is_the_even_rain():
    """The interpolated tables of uneven rain against the drops themselves, at rates between their nodes."""
    position, quantile = np.zeros((500, 2)), (np.arange(500) + 0.5) / 500
    snow = {Precipitation.DRY_SNOW: 0.4}
    for rate in (0.7, 41.0):
        even = UniformVolume(Weather(carrier_hz=77e9, rain_rate_mm_per_h=rate, snowfall_mm_per_h=snow))
        rain = CombinedRain(maps=(), everywhere_mm_per_h=rate)
        uneven = volume_of(Weather(carrier_hz=77e9, rain_map=rain, snowfall_mm_per_h=snow))
        assert isinstance(uneven, NonUniformVolume)
        found = uneven.reflectivity_per_m * uneven.relative(position)
        np.testing.assert_allclose(found, even.reflectivity_per_m, rtol=0.01)
        speeds = [np.sort(volume.fall_mps(position, quantile)) for volume in (uneven, even)]
        assert np.quantile(np.abs(speeds[0] - speeds[1]), 0.97) < 0.1
        assert uneven.fall_mps(position, quantile).mean() == pytest.approx(
            even.fall_mps(position, quantile).mean(), abs=0.03
        )


def test_several_kinds_move_each_at_its_own_speed():
    weather = Weather(
        carrier_hz=77e9,
        rain_rate_mm_per_h=0.3,
        snowfall_mm_per_h={Precipitation.DRY_SNOW: 2.0},
        liquid_water_g_per_m3=0.5,
    )
    volume = UniformVolume(weather)
    parts = [weather.rain_reflectivity_per_m, *(reflectivity for reflectivity, _ in weather.static_echoes)]
    assert volume.reflectivity_per_m == pytest.approx(sum(parts), rel=1e-12)
    quantile = (np.arange(20_000) + 0.5) / 20_000
    means = [weather.rain_speeds().at(quantile).mean(), *(s.at(quantile).mean() for _, s in weather.static_echoes)]
    expected = np.dot(parts, means) / sum(parts)
    assert volume.fall_mps(np.zeros((20_000, 2)), quantile).mean() == pytest.approx(expected, rel=1e-3)
    assert volume_of(Weather(carrier_hz=77e9)) is None
