"""The weather on the paths: every echo loses what its own way costs, and clear air leaves it as it was."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beams import make_antenna, make_chirp
from flights import make_pulses
from sionna_radar.flight.frames import whisk_broom_from_antenna, world_from_body
from sionna_radar.flight.pulses import Pose
from sionna_radar.scenario import load_scenario
from sionna_radar.scene.model import Target
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.effects.atmosphere import Atmosphere
from sionna_radar.tracing.effects.targets import trace_targets
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from sionna_radar.tracing.engines.gamma.facets import GammaEngine
from sionna_radar.tracing.paths import FIRST_OBSTACLE
from sionna_radar.tracing.tracer import Tracer
from sionna_radar.weather.conditions import Weather
from sionna_radar.weather.fog import fog_attenuation_db_per_km
from sionna_radar.weather.gases import Air, gas_attenuation_db_per_km
from sionna_radar.weather.rain import CombinedRain, RainCell, rain_attenuation_db_per_km, rain_power_laws
from sionna_radar.weather.validity import Precipitation
from worlds import make_surface

CARRIER_HZ = 77e9


def power_db(paths):
    return 20 * np.log10(np.abs(paths.gain.astype(complex)))


def test_a_point_target_loses_the_closed_form(pencil):
    """Straight down the polarization does not matter: P.838 at 90 deg of elevation, twice the way."""
    caster = RayCaster([make_surface(lambda x, y: 0 * x)])
    chirp, pulses = make_chirp(), make_pulses(3)
    clear = trace_targets([Target(position_m=(0.0, 0.0, 0.0), rcs_m2=1.0)], pulses, pencil, chirp, caster)
    air = Air()
    weather = Weather(carrier_hz=CARRIER_HZ, liquid_water_g_per_m3=0.5, air=air)
    left = Atmosphere(weather, pencil, chirp, 1).through(clear, pulses)
    fog = fog_attenuation_db_per_km(CARRIER_HZ, liquid_water_g_per_m3=0.5, temperature_k=288.15)
    expected = 2 * 0.050 * (fog + gas_attenuation_db_per_km(CARRIER_HZ, air))
    np.testing.assert_allclose(power_db(clear) - power_db(left), expected, rtol=1e-9)

    raining = Atmosphere(Weather(carrier_hz=CARRIER_HZ, rain_rate_mm_per_h=25.0), pencil, chirp, 1)
    left = raining.through(raining.with_volume(clear, pulses), pulses)
    rain = rain_attenuation_db_per_km(CARRIER_HZ, rain_rate_mm_per_h=25.0, elevation_rad=-np.pi / 2, tilt_rad=0.0)
    target = left.surface <= FIRST_OBSTACLE
    np.testing.assert_allclose(power_db(clear) - 20 * np.log10(np.abs(left.gain[target])), 0.1 * rain, rtol=1e-9)
    assert np.sum(left.surface == -2) == len(left) - 3 > 100


@settings(max_examples=40)
@given(st.floats(0, 85), st.floats(-80, 80), st.floats(-180, 180), st.sampled_from("VH"))
def test_the_tilt_of_the_field_counts(incidence_deg, scan_deg, heading_deg, field_axis):
    antenna = make_antenna(4.0, 4.0, field_axis)
    weather = Weather(carrier_hz=CARRIER_HZ, rain_rate_mm_per_h=40.0)
    euler = np.array([[0.1, -0.2, np.deg2rad(heading_deg)]])
    turn = world_from_body(euler) @ whisk_broom_from_antenna(np.deg2rad(incidence_deg), np.deg2rad([scan_deg]))
    pose = Pose(position_m=np.zeros((1, 3)), velocity_mps=np.zeros((1, 3)), R_world_antenna=turn)
    d, field = turn[0, :, 0], turn[0, :, 2 if field_axis == "V" else 1]
    level = np.cross([0.0, 0.0, 1.0], d)
    tilt = np.arccos(np.clip(abs(field @ level) / np.linalg.norm(level), 0, 1))
    expected = rain_attenuation_db_per_km(
        CARRIER_HZ, rain_rate_mm_per_h=40.0, elevation_rad=float(np.arcsin(d[2])), tilt_rad=float(tilt)
    )
    found = Atmosphere(weather, antenna, make_chirp(), 1).attenuation_db_per_km(pose)
    assert found[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("engine", ["sionna", "gamma"])
def test_both_engines_paths_pass_the_same_weather(engine, plane, pencil):
    chirp, pulses, caster = make_chirp(), make_pulses(2, incidence_deg=45.0), RayCaster(plane.surfaces)
    if engine == "gamma":
        traced = GammaEngine(plane, pencil, chirp, 1, caster)
    else:
        traced = BeamEngine(plane, pencil, chirp, 1, 64, 0.05)
    atmosphere = Atmosphere(Weather(carrier_hz=CARRIER_HZ, air=Air()), pencil, chirp, 1)
    clear = Tracer(traced, plane, pencil, chirp, caster).trace(pulses)
    hazy = Tracer(traced, plane, pencil, chirp, caster, atmosphere=atmosphere).trace(pulses)
    range_km = clear.delay_s * 299_792.458 / 2
    expected = 2 * range_km * gas_attenuation_db_per_km(CARRIER_HZ, Air())
    np.testing.assert_allclose(power_db(clear) - power_db(hazy), expected, atol=2e-6)


def test_rain_by_place_takes_the_integral_along_the_way(pencil):
    """Straight through the middle of a shower, k R^alpha integrates to k peak^alpha radius / alpha on each side."""
    caster = RayCaster([make_surface(lambda x, y: 0 * x)])
    chirp, pulses = make_chirp(), make_pulses(2, incidence_deg=60.0)
    pose = pulses.true
    target = tuple(float(v) for v in pose.position_m[0] + 100.0 * pose.boresight[0])
    clear = trace_targets([Target(position_m=target, rcs_m2=1.0)], pulses, pencil, chirp, caster)
    middle = tuple(float(v) for v in pose.position_m[0, :2] + 70.0 * pose.boresight[0, :2])
    cell = RainCell(centre_m=middle, radius_m=12.0, peak_mm_per_h=80.0)
    atmosphere = Atmosphere(Weather(carrier_hz=CARRIER_HZ, rain_map=CombinedRain(maps=(cell,))), pencil, chirp, 1)
    lost_db = power_db(clear) - power_db(atmosphere.through(clear, pulses))

    field = pose.R_world_antenna[0, :, 2]
    d = pose.boresight[0]
    mix = 2 * (field[1] * d[0] - field[0] * d[1]) ** 2 - (1 - d[2] ** 2)
    k, alpha = (float(v[0]) for v in rain_power_laws(CARRIER_HZ, np.array([mix])))
    slant_m = 12.0 / np.hypot(d[0], d[1]) / alpha
    one_way = k * 80.0**alpha * slant_m / 1000 * (2 - np.exp(-70 / slant_m) - np.exp(-30 / slant_m))
    assert lost_db[0] == pytest.approx(2 * one_way, rel=1e-3)


def test_even_rain_told_by_place_is_even_rain(pencil):
    caster = RayCaster([make_surface(lambda x, y: 0 * x)])
    chirp, pulses = make_chirp(), make_pulses(3, incidence_deg=50.0)
    clear = trace_targets([Target(position_m=(-40.0, 3.0, 0.0), rcs_m2=1.0)], pulses, pencil, chirp, caster)
    air, snow = Air(), {Precipitation.DRY_SNOW: 1.0}
    even = Weather(carrier_hz=CARRIER_HZ, rain_rate_mm_per_h=20.0, air=air, snowfall_mm_per_h=snow, wet_radome_m=0.1)
    told = Weather(
        carrier_hz=CARRIER_HZ,
        rain_map=CombinedRain(maps=(), everywhere_mm_per_h=20.0),
        air=air,
        snowfall_mm_per_h=snow,
        wet_radome_m=0.1,
    )
    left = [Atmosphere(weather, pencil, chirp, 1).through(clear, pulses) for weather in (even, told)]
    np.testing.assert_allclose(power_db(left[0]), power_db(left[1]), atol=1e-9)
    dry = Atmosphere(dataclasses.replace(even, wet_radome_m=None), pencil, chirp, 1).through(clear, pulses)
    np.testing.assert_allclose(power_db(dry) - power_db(left[0]), even.wet_radome_loss_db(20.0), atol=1e-9)
    assert even.wet_radome_loss_db(20.0) > 5.0


def test_clear_air_hands_the_very_paths_on(plane, pencil):
    chirp, pulses = make_chirp(), make_pulses(2, incidence_deg=45.0)
    paths = BeamEngine(plane, pencil, chirp, 1, 64, 0.05).trace(pulses)
    assert Atmosphere(Weather(carrier_hz=CARRIER_HZ), pencil, chirp, 1).through(paths, pulses) is paths


def test_the_receivers_noise_does_not_know_the_weather():
    clear, rainy = (
        prepare(load_scenario("roof_edge", {"weather.rain_rate_mm_per_h": rate})).receiver.noise_power_w
        for rate in (0.0, 50.0)
    )
    assert clear == rainy
