"""A lidar in weather: which pulses hear the ground, which read fog or a drop, against closed forms."""

import numpy as np
import pytest
from scipy.optimize import brentq

from direct_receiver import points_at
from flights import make_pulses
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import load_scenario, parse_scenario
from sionna_radar.scenario.lidar import LidarTable
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.signal.build import lidar_receiver
from sionna_radar.signal.lidar import LidarReceiver
from sionna_radar.survey.chain import run
from sionna_radar.tracing.paths import VOLUME, Paths

C = 299_792_458.0


def receiver(weather=None, **lidar) -> LidarReceiver:
    made = lidar_receiver(LidarTable(wavelength_nm=905, **lidar), WeatherTable(**(weather or {})), 3)
    assert made is not None
    return made


def ground_at(range_m: np.ndarray) -> Paths:
    count = len(range_m)
    return points_at(range_m, pulse=np.arange(count), incidence_rad=np.full(count, np.pi / 3))


def test_in_clear_air_the_range_is_that_of_the_threshold():
    """Ground of 30 % at 60 deg returns 15 %: by r^-2 it is heard to 200 m sqrt(1.5)."""
    reach = 200 * np.sqrt(1.5)
    range_m = np.array([30.0, reach - 0.1, reach + 0.1, 0.5])
    read = receiver().received(ground_at(range_m), make_pulses(4))
    np.testing.assert_array_equal(read.pulse, [0, 1])
    np.testing.assert_allclose(read.delay_s * C / 2, range_m[:2])
    np.testing.assert_array_equal(read.surface, 0)


def test_fog_ends_it_where_its_extinction_says():
    air = {"dust_visibility_m": 200.0}
    loss = 2 * 3.912 / 200
    reach = brentq(lambda r: 0.15 * np.exp(-loss * r) - 0.1 * (r / 200) ** 2, 1, 200)
    read = receiver(air).received(ground_at(np.array([reach - 0.05, reach + 0.05])), make_pulses(2))
    np.testing.assert_array_equal(read.pulse, [0])


def test_thick_fog_is_the_first_return_and_not_the_last():
    fog = {"fog_visibility_m": 100.0}
    first = receiver(fog).received(ground_at(np.array([20.0, 90.0])), make_pulses(2))
    np.testing.assert_array_equal(first.surface, VOLUME)
    np.testing.assert_allclose(first.delay_s * C / 2, 1.0)
    last = receiver(fog, returns="last").received(ground_at(np.array([20.0, 90.0])), make_pulses(2))
    np.testing.assert_array_equal(last.surface, [0, VOLUME])
    # pi b l of a short pulse is what a target has that returns as much.
    short = receiver(fog, pulse_ns=0.1)
    assert short.volume_reflectivity == pytest.approx(np.pi * 0.03912 / 18.8 * C * 1e-10 / 2, rel=1e-3)
    # Gated beyond the fog's own echo, and seen by nobody behind the ground.
    gated = receiver(fog, near_range_m=30.0).received(ground_at(np.array([20.0, 35.0])), make_pulses(2))
    np.testing.assert_array_equal(gated.pulse, [1])
    np.testing.assert_array_equal(gated.surface, [0])


def test_drops_are_met_as_often_as_they_are_in_the_beam():
    rain = receiver({"rain_rate_mm_per_h": 50.0}, least_reflectivity=1e-4)
    range_m, expected = rain.detectable_drops
    count = 20_000
    read = rain.received(ground_at(np.full(count, 60.0)), make_pulses(count))
    met = read.surface == VOLUME
    share = -np.expm1(-np.interp(60.0, range_m, expected))
    assert met.mean() == pytest.approx(share, abs=4 * np.sqrt(share / count))
    assert share > 0.05
    near = np.mean(read.delay_s[met] * C / 2 < 2.0)
    assert near == pytest.approx(-np.expm1(-np.interp(2.0, range_m, expected)) / share, abs=0.05)
    # By hand: drops whose glints, spread over the beam at 1 m, return more than 1e-4.
    area = np.pi / 4 * 0.021**2
    smallest = brentq(lambda d: np.pi * 0.019 * 4.6 * d**2 / 16 / area - 1e-4, 1e-4, 1e-2)
    slope = 4100 * 50**-0.21
    in_a_metre = area * 8e6 / slope * np.exp(-slope * smallest)
    assert expected[1] / (range_m[1] - range_m[0]) == pytest.approx(in_a_metre, rel=0.2)


def test_a_pulse_meets_the_same_drop_in_any_block():
    rain = receiver({"rain_rate_mm_per_h": 50.0}, least_reflectivity=1e-5)
    whole = rain.received(ground_at(np.full(40, 60.0)), make_pulses(40))
    assert np.any(whole.surface == VOLUME)
    part = ground_at(np.full(40, 60.0)).rows(np.arange(40) >= 25)
    late = rain.received(part, make_pulses(15, first=25))
    np.testing.assert_array_equal(late.delay_s, whole.delay_s[25:])


def flat(**tables) -> object:
    return parse_scenario(
        {
            "terrain": {"kind": "flat"},
            "platform": {"altitude_m": 50.0, "speed_mps": 10.0, "length_m": 5.0, "start_m": [-40.0, 0.0]},
            "radar": {"snr_db": 30.0},
            "sensor": "lidar",
            **tables,
        }
    )


def test_a_survey_with_light_in_clear_air_is_that_of_the_exact_sensor():
    exact, light = run(flat()), run(flat(lidar={"wavelength_nm": 905}))
    assert exact.points.sha256() == light.points.sha256()


def test_what_the_lidar_misses_is_missing_from_the_coverage():
    keys = {"wavelength_nm": 1550, "near_range_m": 30.0}
    survey = run(flat(lidar=keys, weather={"dust_visibility_m": 200.0}))
    assert 0 < len(survey.points) < survey.pulses
    assert survey.lit_error.coverage < 0.9
    assert survey.lit_error.rms_m < 0.02


def test_keys_of_light_need_a_wavelength_and_even_rain():
    with pytest.raises(ScenarioError, match=r"lidar.clear_range_m: 100.0 has no effect without wavelength_nm"):
        flat(lidar={"clear_range_m": 100.0})
    cell = {"rain_cell": {"centre_m": [0.0, 0.0], "radius_m": 50.0, "peak_mm_per_h": 10.0}}
    with pytest.raises(ScenarioError, match=r"weather.rain_cell: rain that varies from place to place"):
        load_scenario("hills", {"sensor": "lidar", "lidar.wavelength_nm": 905, "weather": cell})
