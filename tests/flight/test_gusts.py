"""Wind: the spectrum of its gusts is Dryden's, the aircraft answers as its linear model does, and nothing jumps."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import welch

from sionna_radar.flight.build import build_scan, build_wind, flight_plan, plan_track
from sionna_radar.flight.gusts import DAMPING, DRAG_S, Dryden, Gusts, dryden_axes, in_wind
from sionna_radar.flight.pulses import schedule_pulses
from sionna_radar.flight.trajectory import Trajectory, plan_trajectory
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario.platform import Platform, WindTable
from sionna_radar.scenario.radar import ScanTable

ALONG = Dryden(sigma_mps=1.5, time_s=0.8, along=True)
ACROSS = Dryden(sigma_mps=1.5, time_s=0.8, along=False)


def still(**keys: object) -> Trajectory:
    platform = Platform(**({"altitude_m": 60.0, "speed_mps": 10.0, "length_m": 200.0} | keys))
    return plan_trajectory(flight_plan(platform), plan_track(platform), lambda point_m: np.zeros(len(point_m)))


def windy(seed: int = 1, still_air: Trajectory | None = None, **wind: object) -> Trajectory:
    return in_wind(still_air or still(), build_wind(WindTable(**wind)), 60.0, 10.0, seed)


@pytest.fixture(scope="module")
def long_gusts() -> Gusts:
    axes = (ALONG, ACROSS, Dryden(sigma_mps=0.7, time_s=2.0, along=False))
    return Gusts(axes=axes, end_s=4000.0, attitude_s=0.4, position_s=1.0, seed=3)


@pytest.mark.parametrize("axis", [ALONG, ACROSS])
def test_the_density_integrates_to_the_variance(axis):
    power, _ = quad(lambda w: float(axis.density(np.array([w]))[0]), 0, np.inf)
    assert power == pytest.approx(1.5**2, rel=1e-6)


@pytest.mark.parametrize("axis", [ALONG, ACROSS])
def test_the_shaping_filter_has_the_density_of_the_model(axis):
    """|C (i w - A)^-1 B|^2 of unit white noise, one-sided, per rad/s: over pi."""
    matrix, drive, output = axis.state_space
    omega = np.geomspace(0.01, 100, 30)
    shaped = [abs(output @ np.linalg.solve(1j * w * np.eye(len(drive)) - matrix, drive)) ** 2 / np.pi for w in omega]
    np.testing.assert_allclose(shaped, axis.density(omega), rtol=1e-9)


def test_lengths_and_intensities_of_the_low_altitude_model():
    """MIL-F-8785C at 200 ft: L_w = 200 ft, L_u = 200 / 0.3416^1.2 ft, sigma_u / sigma_w = 0.3416^-0.4."""
    along, across, up = dryden_axes(60.96, 12.0, 1.0)
    assert up.time_s == pytest.approx(60.96 / 12.0)
    assert along.time_s == across.time_s == pytest.approx(60.96 / 0.3416**1.2 / 12.0)
    assert along.sigma_mps == pytest.approx(0.3416**-0.4)
    low, high = dryden_axes(1.0, 12.0, 1.0), dryden_axes(5000.0, 12.0, 1.0)
    assert low[2].time_s == pytest.approx(3.048 / 12.0)
    assert high[0].time_s == pytest.approx(high[2].time_s, rel=1e-9)  # isotropic from 1000 ft


@pytest.mark.parametrize("number", [0, 1, 2])
def test_gusts_and_what_follows_them_have_the_spectra_of_the_model(long_gusts, number):
    """Welch's estimate in octaves, against Dryden's density and the model's transfer functions."""
    axis, states = long_gusts.axes[number], long_gusts.states[number]
    step_s = long_gusts.step_s

    def answer(w: np.ndarray) -> np.ndarray:
        loop = -(w**2) + 1j * w * (2 * DAMPING / long_gusts.position_s + 1 / DRAG_S) + 1 / long_gusts.position_s**2
        return 1 / DRAG_S / loop

    transfers = (lambda w: 1.0 + 0 * w, lambda w: 1 / (1 + 1j * w * long_gusts.attitude_s), answer)
    for column, transfer in enumerate(transfers):
        frequency_hz, density = welch(states[:, column], 1 / step_s, nperseg=8192)
        omega = 2 * np.pi * frequency_hz
        expected = axis.density(omega) * np.abs(transfer(omega)) ** 2 * 2 * np.pi
        for low in (0.2, 0.8, 3.2, 8.0):
            band = (omega > low) & (omega < 2 * low)
            assert density[band].sum() == pytest.approx(expected[band].sum(), rel=0.15)
    assert states[:, 0].std() == pytest.approx(axis.sigma_mps, rel=0.08)


def test_they_begin_in_their_stationary_state():
    first = np.array(
        [
            Gusts(axes=(ALONG, ACROSS, ACROSS), end_s=0.1, attitude_s=0.4, position_s=1.0, seed=s).states
            for s in range(100)
        ]
    )
    np.testing.assert_allclose(first[:, :, 0, 0].std(axis=0), 1.5, rtol=0.22)
    np.testing.assert_allclose(first[:, :, -1, 0].std(axis=0), 1.5, rtol=0.22)


def test_the_displacement_s_rate_is_its_derivative_and_velocity_that_of_position():
    flight = windy(speed_mps=6.0, from_deg=40.0, gust_mps=1.0)
    time_s = np.random.default_rng(4).uniform(0.1, 19.9, 400)
    step = 1e-4
    slope = (flight.position(time_s + step) - flight.position(time_s - step)) / (2 * step)
    np.testing.assert_allclose(slope, flight.velocity(time_s), atol=1e-3)
    displaced = np.linalg.norm(flight.position(time_s) - still().position(time_s), axis=1)
    assert 0.005 < displaced.max() < 3.0


def test_a_steady_wind_from_the_side_makes_the_nose_crab():
    """10 m/s over the ground to the east, 5 m/s from the north: the nose points asin(5 / airspeed) to the north."""
    flight = windy(speed_mps=5.0, from_deg=0.0, gust_mps=0.0)
    time_s = np.linspace(0, 20, 11)
    heading = flight.euler(time_s)[:, 2]
    np.testing.assert_allclose(np.rad2deg(heading), 90.0 - np.rad2deg(np.arctan(0.5)), atol=1e-9)
    np.testing.assert_allclose(flight.velocity(time_s), still().velocity(time_s), atol=1e-12)
    straight = windy(speed_mps=5.0, from_deg=0.0, gust_mps=0.0, crab=False)
    np.testing.assert_allclose(straight.euler(time_s), still().euler(time_s), atol=1e-12)


def test_the_nose_turns_into_a_gust_and_the_wing_away_from_it():
    flight = windy(speed_mps=0.0, gust_mps=2.0, seed=5)
    time_s = np.linspace(0, 20, 401)
    shaken = flight.euler(time_s) - still().euler(time_s)
    np.testing.assert_allclose(shaken[:, 0], -shaken[:, 2], atol=1e-12)
    assert 0.5 < np.rad2deg(shaken.std(axis=0)).min() < np.rad2deg(shaken.std(axis=0)).max() < 20.0


def test_gusts_depend_on_the_seed_and_not_on_the_block():
    one, same, other = windy(seed=7, gust_mps=1.0), windy(seed=7, gust_mps=1.0), windy(seed=8, gust_mps=1.0)
    time_s = np.linspace(0, 20, 1000)
    np.testing.assert_array_equal(one.euler(time_s)[500:], same.euler(time_s[500:]))
    assert np.abs(one.euler(time_s) - other.euler(time_s)).max() > 1e-3
    schedule = schedule_pulses(one, build_scan(ScanTable(mode="whisk_broom", stabilised=False)), 100.0)
    blocks = [np.concatenate([b.true.boresight for b in schedule.blocks(size)]) for size in (7, 512)]
    np.testing.assert_array_equal(*blocks)


def test_gusts_shake_the_beam_of_an_antenna_that_is_not_stabilised():
    flight = windy(gust_mps=1.5, crab=False)
    spread = []
    for stabilised in (True, False):
        scan = build_scan(ScanTable(mode="fixed", incidence_deg=0.0, stabilised=stabilised))
        boresight = schedule_pulses(flight, scan, 50.0).sample(1000).true.boresight
        spread.append(np.rad2deg(np.arcsin(np.linalg.norm(boresight[:, :2], axis=1))).max())
    assert spread[0] < 1e-6
    assert spread[1] > 1.0


def test_a_flight_too_long_for_gusts_is_refused():
    with pytest.raises(ScenarioError, match=r"platform\.wind: gusts are limited to"):
        windy(still_air=still(length_m=1e6, speed_mps=1.0))
