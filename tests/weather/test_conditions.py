"""The weather of a survey: losses add up, and the drops that echo fall as fast as drops do."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import parse_scenario
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.tracing.build import build_weather
from sionna_radar.weather.conditions import Weather
from sionna_radar.weather.drops import fall_speed_mps, marshall_palmer
from sionna_radar.weather.fog import fog_attenuation_db_per_km
from sionna_radar.weather.gases import Air, gas_attenuation_db_per_km
from sionna_radar.weather.permittivity import water_permittivity
from sionna_radar.weather.rain import (
    drop_reflectivity_per_m,
    echo_speeds,
    rain_attenuation_db_per_km,
    rain_attenuations_db_per_km,
)
from sionna_radar.weather.scattering import mie_backscatter
from sionna_radar.weather.validity import Obscurant, Precipitation

CARRIER_HZ = 77e9
MIN = {
    "terrain": {"kind": "flat"},
    "platform": {"altitude_m": 50.0, "speed_mps": 10.0},
    "radar": {"snr_db": 30.0},
}


@given(st.floats(-90, 90), st.floats(0, 90), st.floats(0.1, 150))
def test_rain_for_many_looks_is_rain_for_one(elevation_deg, tilt_deg, rate):
    elevation, tilt = math.radians(elevation_deg), math.radians(tilt_deg)
    one = rain_attenuation_db_per_km(CARRIER_HZ, rain_rate_mm_per_h=rate, elevation_rad=elevation, tilt_rad=tilt)
    mix = np.array([math.cos(elevation) ** 2 * math.cos(2 * tilt)])
    many = rain_attenuations_db_per_km(CARRIER_HZ, rain_rate_mm_per_h=rate, mix=mix)
    assert many[0] == pytest.approx(one, rel=1e-12)


def test_losses_of_rain_fog_and_air_add_up():
    mix, air = np.array([-1.0, 0.0, 0.4]), Air(temperature_k=283.15)
    weather = Weather(
        carrier_hz=CARRIER_HZ, rain_rate_mm_per_h=12.0, liquid_water_g_per_m3=0.3, air=air, temperature_k=283.15
    )
    expected = rain_attenuations_db_per_km(CARRIER_HZ, rain_rate_mm_per_h=12.0, mix=mix)
    expected += fog_attenuation_db_per_km(CARRIER_HZ, liquid_water_g_per_m3=0.3, temperature_k=283.15)
    expected += gas_attenuation_db_per_km(CARRIER_HZ, air)
    assert weather.attenuation_db_per_km(mix) == pytest.approx(expected, rel=1e-12)
    clear = Weather(carrier_hz=CARRIER_HZ)
    assert clear.clear
    assert not weather.clear
    assert np.all(clear.attenuation_db_per_km(mix) == 0)


# Gunn and Kinzer 1949 (J. Meteorol. 6, 243), Table 2, as restated in two droplet models (PySDM, and a Julia one).
@pytest.mark.parametrize(("diameter_mm", "speed"), [(1.0, 4.03), (1.2, 4.64), (1.6, 5.65), (2.0, 6.49), (2.6, 7.57)])
def test_drops_fall_as_measured(diameter_mm, speed):
    assert fall_speed_mps(np.array([diameter_mm * 1e-3]))[0] == pytest.approx(speed, rel=0.02)


def test_the_smallest_droplets_float():
    assert fall_speed_mps(np.array([0.0, 5e-5])) == pytest.approx([0.0, 0.0])


def test_the_drops_drawn_for_the_echo_weigh_as_their_reflectivity():
    drops = marshall_palmer(20.0)
    speeds = echo_speeds(CARRIER_HZ, drops=drops, temperature_k=288.15)
    drawn = speeds.at((np.arange(20_000) + 0.5) / 20_000)
    assert np.all(np.diff(drawn) >= 0)
    # A plain sum over thin slices of the diameter, its echo from the drops of that slice alone.
    edge = np.linspace(1e-5, 20 / drops.slope_per_m, 4001)
    middle = (edge[1:] + edge[:-1]) / 2
    size = np.pi * middle * CARRIER_HZ / 299_792_458.0
    back = mie_backscatter(size, water_permittivity(CARRIER_HZ, 288.15) ** 0.5)
    weight = drops.density_per_m4(middle) * np.pi / 4 * middle**2 * back
    assert weight.sum() * (edge[1] - edge[0]) == pytest.approx(
        drop_reflectivity_per_m(CARRIER_HZ, drops=drops, temperature_k=288.15), rel=1e-3
    )
    assert drawn.mean() == pytest.approx(weight @ fall_speed_mps(middle) / weight.sum(), rel=0.01)


def test_a_scenario_says_what_falls_and_how_far_one_sees():
    table = WeatherTable(
        rain_rate_mm_per_h=2.0, snowfall_mm_per_h=1.0, snow="wet", fog="medium", smoke_visibility_m=400.0
    )
    assert table.precipitation_mm_per_h == {Precipitation.RAIN: 2.0, Precipitation.WET_SNOW: 1.0}
    assert table.visibility_m == {Obscurant.FOG: 300.0, Obscurant.SMOKE: 400.0}
    assert table.falling == "rain and wet snow"
    assert WeatherTable().falling == ""
    assert not WeatherTable().precipitation_mm_per_h
    assert not WeatherTable(liquid_water_g_per_m3=0.1).visibility_m
    shower = {"centre_m": (0.0, 0.0), "radius_m": 100.0, "peak_mm_per_h": 9.0}
    assert WeatherTable(rain_cell=shower, snowfall_mm_per_h=0.5).falling == "rain and dry snow"
    # A mean fog of 300 m (Kunkel 1984) has a third more water than the ITU's; water given by value stands.
    assert WeatherTable(fog_visibility_m=300.0).water_in_air_g_per_m3 == pytest.approx(0.065, abs=0.001)
    assert WeatherTable(fog_visibility_m=300.0, liquid_water_g_per_m3=0.2).water_in_air_g_per_m3 == 0.2


def test_every_kind_of_air_takes_its_part():
    one = {
        "haze_visibility_m": 2000.0,
        "dust_visibility_m": 200.0,
        "smoke_visibility_m": 100.0,
        "snowfall_mm_per_h": 1.0,
    }
    alone = [build_weather(WeatherTable(**{key: value}), CARRIER_HZ) for key, value in one.items()]
    together = build_weather(WeatherTable(**one), CARRIER_HZ)
    mix = np.array([0.3])
    losses = [weather.attenuation_db_per_km(mix)[0] for weather in alone]
    assert min(losses) > 0
    assert together.attenuation_db_per_km(mix)[0] == pytest.approx(sum(losses), rel=1e-12)
    assert all(weather.fills_the_beam and not weather.clear for weather in alone)


def test_only_water_wets_a_radome():
    wet = {"wet_radome": {"radius_m": 0.1}}
    dry_snow, wet_snow, rain = (
        build_weather(WeatherTable(**wet, **kind), CARRIER_HZ)
        for kind in (
            {"snowfall_mm_per_h": 2.0},
            {"snowfall_mm_per_h": 2.0, "snow": "wet"},
            {"rain_rate_mm_per_h": 2.0},
        )
    )
    assert dry_snow.wet_radome_loss_db(0.0) == pytest.approx(0.0)
    assert wet_snow.wet_radome_loss_db(0.0) == rain.wet_radome_loss_db(2.0) > 3.0


def test_a_scenario_gives_its_weather():
    table = WeatherTable(fog="thick", gases=True, dry_pressure_hpa=900.0, vapour_g_per_m3=3.0, temperature_k=280.0)
    weather = build_weather(table, CARRIER_HZ)
    assert weather.liquid_water_g_per_m3 == 0.5
    assert weather.air == Air(dry_pressure_pa=90_000.0, temperature_k=280.0, vapour_density_g_per_m3=3.0)
    assert build_weather(WeatherTable(), CARRIER_HZ).clear
    assert build_weather(WeatherTable(liquid_water_g_per_m3=0.2), CARRIER_HZ).liquid_water_g_per_m3 == 0.2


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"weather": {"rain_rate_mm_per_h": -1.0}}, "weather.rain_rate_mm_per_h"),
        ({"weather": {"rain_rate_mm_per_h": 400.0}}, "weather.rain_rate_mm_per_h"),
        ({"weather": {"fog": "dense"}}, "weather.fog"),
        ({"weather": {"fog": "thick", "liquid_water_g_per_m3": 0.1}}, "weather.liquid_water_g_per_m3"),
        ({"weather": {"temperature_k": 200.0}}, "weather.temperature_k"),
        ({"weather": {"vapour_g_per_m3": 3.0}}, "weather.gases"),
        ({"weather": {"fog": "thick"}, "radar": {"snr_db": 30.0, "carrier_hz": 240e9}}, "weather.fog"),
        ({"weather": {"fog": "thick", "fog_visibility_m": 50.0}}, "weather.fog_visibility_m"),
        ({"weather": {"snow": "slush"}}, "weather.snow"),
        ({"weather": {"snowfall_mm_per_h": 50.0}}, "weather.snowfall_mm_per_h"),
        ({"weather": {"dust_visibility_m": 0.0}}, "weather.dust_visibility_m"),
        ({"weather": {"wind_mps": [0.0, 90.0, 0.0]}}, "weather.wind_mps"),
        ({"weather": {"wet_radome": {"radius_m": 0.0}}}, "weather.wet_radome.radius_m"),
        ({"weather": {"rain_cell": {"centre_m": [0.0, 0.0], "radius_m": 10.0}}}, "weather.rain_cell.peak_mm_per_h"),
        ({"weather": {"rain_field": {"correlation_m": 50.0, "spread_db": -1.0}}}, "weather.rain_field.spread_db"),
        (
            {"weather": {"snowfall_mm_per_h": 1.0}, "radar": {"snr_db": 30.0, "carrier_hz": 5e9}},
            "weather.snowfall_mm_per_h",
        ),
        (
            {"weather": {"haze_visibility_m": 900.0}, "radar": {"snr_db": 30.0, "carrier_hz": 160e9}},
            "weather.haze_visibility_m",
        ),
        ({"targets": [{"position_m": [0.0, 0.0], "rcs_dbsm": 0.0, "swerling": 5}]}, "targets.0.swerling"),
    ],
)
def test_weather_that_cannot_be_is_refused(changes, field):
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(MIN | changes)
    assert [problem.field for problem in caught.value.problems] == [field]
