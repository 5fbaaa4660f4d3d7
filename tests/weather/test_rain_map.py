"""Rain by place: a shower's profile, a field's statistics, and what an even field comes to."""

import numpy as np
import pytest

from sionna_radar.weather.conditions import Weather
from sionna_radar.weather.rain_map import RainCell, RainField, RainTogether
from sionna_radar.weather.validity import Precipitation
from sionna_radar.weather.volume import EvenVolume, UnevenVolume, volume_of


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
        even = EvenVolume(Weather(carrier_hz=77e9, rain_rate_mm_per_h=rate, snowfall_mm_per_h=snow))
        rain = RainTogether(parts=(), everywhere_mm_per_h=rate)
        uneven = volume_of(Weather(carrier_hz=77e9, rain_map=rain, snowfall_mm_per_h=snow))
        assert isinstance(uneven, UnevenVolume)
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
    volume = EvenVolume(weather)
    parts = [weather.rain_reflectivity_per_m, *(reflectivity for reflectivity, _ in weather.still_echoes)]
    assert volume.reflectivity_per_m == pytest.approx(sum(parts), rel=1e-12)
    quantile = (np.arange(20_000) + 0.5) / 20_000
    means = [weather.rain_speeds().at(quantile).mean(), *(s.at(quantile).mean() for _, s in weather.still_echoes)]
    expected = np.dot(parts, means) / sum(parts)
    assert volume.fall_mps(np.zeros((20_000, 2)), quantile).mean() == pytest.approx(expected, rel=1e-3)
    assert volume_of(Weather(carrier_hz=77e9)) is None
