"""Flights and frames: velocities as derivatives, phases, waypoints; elementary rotations written out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sionna_radar.flight.build import flight_plan, plan_track
from sionna_radar.flight.frames import (
    R_WORLD_NED,
    conical_from_antenna,
    whisk_broom_from_antenna,
    world_from_body,
    world_from_level,
)
from sionna_radar.flight.trajectory import Phase, Trajectory, plan_trajectory
from sionna_radar.scenario.platform import Platform


def rolling(point_m: np.ndarray) -> np.ndarray:
    return 3 + 2 * np.sin(point_m[:, 0] / 30) + 0.05 * point_m[:, 1]


def flat(point_m: np.ndarray) -> np.ndarray:
    return np.full(len(point_m), 120.0)


def plan(ground_m=flat, **values: object) -> Trajectory:
    platform = Platform(**({"altitude_m": 50.0, "speed_mps": 10.0} | values))
    return plan_trajectory(flight_plan(platform), plan_track(platform), ground_m)


FLIGHTS = {
    "level": {},
    "full": {"profile": "full"},
    "short climb": {"profile": "full", "altitude_m": 7.0, "climb_rate_mps": 8.0, "descent_rate_mps": 1.0},
    "following": {"height": "terrain_following", "length_m": 300.0},
    "following, full": {"height": "terrain_following", "profile": "full", "heading_deg": 33.0},
    "sensed": {"height": "sensed", "length_m": 300.0},
    "sensed, full": {"height": "sensed", "profile": "full", "height_response_s": 3.0},
    "waypoints": {"waypoints_m": ((0.0, 0.0), (60.0, 0.0), (60.0, 80.0), (-40.0, 80.0)), "profile": "full"},
}


@pytest.mark.parametrize("values", FLIGHTS.values(), ids=FLIGHTS.keys())
def test_velocity_is_the_derivative_of_position(values):
    flight = plan(rolling, **values)
    time_s = np.random.default_rng(1).uniform(0.01, flight.end_s - 0.01, 2000)
    step = 1e-4
    before, after = flight.position(time_s - step), flight.position(time_s + step)
    difference = np.linalg.norm((after - before) / (2 * step) - flight.velocity(time_s), axis=1)
    # The velocity jumps at the ends of the phases and at waypoints: a few of 2000 random times hit one.
    assert np.sum(difference > 1e-3) <= 3
    assert np.median(difference) < 1e-6


@pytest.mark.parametrize("values", FLIGHTS.values(), ids=FLIGHTS.keys())
def test_phases_follow_each_other_without_a_gap_or_a_jump(values):
    flight = plan(rolling, **values)
    names = [phase for phase, _, _ in flight.phases]
    full = [Phase.TAKE_OFF, Phase.CLIMB, Phase.CRUISE, Phase.DESCENT, Phase.LANDING]
    assert names == (full if values.get("profile") == "full" else [Phase.CRUISE])
    starts, ends = np.array([(start, end) for _, start, end in flight.phases]).T
    assert starts[0] == 0.0
    np.testing.assert_array_equal(starts[1:], ends[:-1])
    assert np.all(ends > starts)
    for edge in ends[:-1]:
        before, after = flight.position(np.array([edge - 1e-7, edge + 1e-7]))
        np.testing.assert_allclose(before, after, atol=1e-5)


def test_a_full_flight_starts_and_ends_at_rest_on_the_ground():
    flight = plan(rolling, profile="full", length_m=80.0, start_m=(10.0, -5.0), heading_deg=0.0)
    (start, end), (v_start, v_end) = (f(np.array([0.0, flight.end_s])) for f in (flight.position, flight.velocity))
    np.testing.assert_allclose(start, [10, -5, rolling(np.array([[10.0, -5.0]]))[0]], atol=1e-9)
    np.testing.assert_allclose(end, [10, 75, rolling(np.array([[10.0, 75.0]]))[0]], atol=1e-6)
    np.testing.assert_allclose([v_start, v_end], np.zeros((2, 3)), atol=1e-6)


def test_climb_and_descent_keep_their_rates_and_the_acceleration():
    flight = plan(profile="full", climb_rate_mps=3.0, descent_rate_mps=1.5, acceleration_mps2=0.8)
    time_s = np.linspace(0, flight.end_s, 200_001)
    vertical = flight.velocity(time_s)[:, 2]
    assert vertical.max() == pytest.approx(3.0)
    assert vertical.min() == pytest.approx(-1.5)
    acceleration = np.diff(vertical) / np.diff(time_s)
    assert np.abs(acceleration).max() == pytest.approx(0.8, rel=1e-3)
    # A trapezoid of speed v over a distance d with acceleration a lasts d / v + v / a.
    durations = {phase: end - start for phase, start, end in flight.phases}
    assert durations[Phase.TAKE_OFF] == pytest.approx(2 * np.sqrt(5.0 / 0.8))  # too short to reach 3 m/s
    assert durations[Phase.CLIMB] == pytest.approx(45.0 / 3.0 + 3.0 / 0.8)
    assert durations[Phase.CRUISE] == pytest.approx(10.0)
    assert durations[Phase.DESCENT] == pytest.approx(45.0 / 1.5 + 1.5 / 0.8)


def test_level_flight_keeps_the_altitude_above_the_ground_under_the_start():
    flight = plan(rolling, start_m=(20.0, 40.0), heading_deg=45.0, length_m=70.0)
    time_s = np.linspace(0, flight.end_s, 50)
    expected = 3 + 2 * np.sin(20 / 30) + 0.05 * 40 + 50
    np.testing.assert_allclose(flight.position(time_s)[:, 2], expected, atol=1e-9)
    np.testing.assert_allclose(flight.velocity(time_s), np.tile([10 / np.sqrt(2), 10 / np.sqrt(2), 0], (50, 1)))
    np.testing.assert_allclose(flight.euler(time_s), np.tile([0, 0, np.pi / 4], (50, 1)))


def test_terrain_following_keeps_its_height_over_a_slope():
    flight = plan(lambda p: 0.2 * p[:, 0], height="terrain_following", length_m=400.0, follow_length_m=40.0)
    time_s = np.linspace(0.1, 39.9, 100)
    x, _, z = flight.position(time_s).T
    np.testing.assert_allclose(z, 0.2 * x + 50, atol=1e-3)
    np.testing.assert_allclose(flight.velocity(time_s), np.tile([10.0, 0.0, 2.0], (100, 1)), atol=1e-3)


def test_terrain_following_smooths_what_is_shorter_than_its_length():
    ground = lambda p: 10 * np.sin(2 * np.pi * p[:, 0] / 20)  # noqa: E731
    flight = plan(ground, height="terrain_following", length_m=600.0, follow_length_m=200.0)
    z = flight.position(np.linspace(15, 45, 300))[:, 2]
    assert np.abs(z - 50).max() < 2.0  # of waves 10 m high


def test_a_sensed_height_is_late_by_what_the_flight_climbs_in_its_time_constant():
    flight = plan(lambda p: 0.2 * p[:, 0], height="sensed", height_response_s=1.5, length_m=400.0)
    time_s = np.linspace(0.0, 40.0, 200)
    x, _, z = flight.position(time_s).T
    np.testing.assert_allclose(z - 0.2 * x - 50, -1.5 * 2.0 * (1 - np.exp(-time_s / 1.5)), atol=1e-3)


def test_waves_are_followed_as_by_a_first_order_filter():
    wave_per_m, lag_m = 2 * np.pi / 80, 20.0
    ground = lambda p: 10 * np.sin(wave_per_m * p[:, 0])  # noqa: E731
    flight = plan(ground, height="sensed", height_response_s=lag_m / 10.0, length_m=800.0)
    x, _, z = flight.position(np.linspace(30, 80, 500)).T
    expected = 10 * np.imag(np.exp(1j * wave_per_m * x) / (1 + 1j * wave_per_m * lag_m))
    np.testing.assert_allclose(z - 50, expected, atol=0.03)


def test_track_without_a_start_is_centred():
    flight = plan(heading_deg=90.0, length_m=100.0)
    start, end = flight.position(np.array([0.0, flight.end_s]))
    np.testing.assert_allclose(start, [-50, 0, 170], atol=1e-9)
    np.testing.assert_allclose(end, [50, 0, 170], atol=1e-9)


def test_waypoints_are_reached_on_time_with_the_heading_of_their_leg():
    flight = plan(waypoints_m=((0.0, 0.0), (60.0, 0.0), (60.0, 80.0), (0.0, 0.0)))
    time_s = np.array([0.0, 6.0, 14.0, 24.0])
    np.testing.assert_allclose(flight.position(time_s)[:, :2], [[0, 0], [60, 0], [60, 80], [0, 0]], atol=1e-9)
    heading = np.rad2deg(flight.euler(np.array([3.0, 10.0, 20.0]))[:, 2])
    np.testing.assert_allclose(heading, [90, 0, np.rad2deg(np.arctan2(-60, -80))], atol=1e-9)
    velocity = flight.velocity(np.array([3.0, 10.0, 20.0]))
    np.testing.assert_allclose(velocity, [[10, 0, 0], [0, 10, 0], [-6, -8, 0]], atol=1e-9)
    assert flight.end_s == pytest.approx(24.0)


angle = st.floats(-3.1, 3.1)
pitch_angle = st.floats(-1.5, 1.5)


def about(axis: int, t: float) -> np.ndarray:
    """The elementary right-handed turn about x, y or z."""
    c, s = np.cos(t), np.sin(t)
    return [
        np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    ][axis]


def test_ned_axes_in_world_are_north_east_and_down():
    np.testing.assert_array_equal(R_WORLD_NED.T, [[0, 1, 0], [1, 0, 0], [0, 0, -1]])


@pytest.mark.parametrize(
    ("roll", "pitch", "heading", "nose", "right"),
    [
        (0, 0, 0, (0, 1, 0), (1, 0, 0)),
        (0, 0, 90, (1, 0, 0), (0, -1, 0)),
        (0, 0, 180, (0, -1, 0), (-1, 0, 0)),
        (0, 0, 270, (-1, 0, 0), (0, 1, 0)),
        (0, 30, 0, (0, np.sqrt(0.75), 0.5), (1, 0, 0)),  # pitch lifts the nose
        (30, 0, 0, (0, 1, 0), (np.sqrt(0.75), 0, -0.5)),  # roll lowers the right wing
        (0, 30, 90, (np.sqrt(0.75), 0, 0.5), (0, -1, 0)),
    ],
)
def test_body_axes_point_where_a_pilot_expects_them(roll, pitch, heading, nose, right):
    R_world_body = world_from_body(np.deg2rad([[float(roll), pitch, heading]]))[0]
    np.testing.assert_allclose(R_world_body[:, 0], nose, atol=1e-12)
    np.testing.assert_allclose(R_world_body[:, 1], right, atol=1e-12)
    np.testing.assert_allclose(R_world_body[:, 2], np.cross(nose, right), atol=1e-12)


@given(angle, pitch_angle, angle)
def test_euler_angles_compose_heading_pitch_roll(roll, pitch, heading):
    expected = R_WORLD_NED @ about(2, heading) @ about(1, pitch) @ about(0, roll)
    np.testing.assert_allclose(world_from_body(np.array([[roll, pitch, heading]]))[0], expected, atol=1e-12)


@given(angle, pitch_angle, angle)
def test_stabilised_axes_keep_the_heading_alone(roll, pitch, heading):
    expected = R_WORLD_NED @ about(2, heading)
    np.testing.assert_allclose(world_from_level(np.array([[roll, pitch, heading]]))[0], expected, atol=1e-12)


@given(st.floats(0, 1.5), angle)
def test_whisk_broom_boresight(a, b):
    R = whisk_broom_from_antenna(a, np.array([b]))[0]
    np.testing.assert_allclose(R[:, 0], [np.sin(a), np.cos(a) * np.sin(b), np.cos(a) * np.cos(b)], atol=1e-12)


@given(st.floats(0, 1.5), angle)
def test_conical_boresight(a, b):
    R = conical_from_antenna(a, np.array([b]))[0]
    np.testing.assert_allclose(R[:, 0], [np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], atol=1e-12)


@pytest.mark.parametrize("build", [whisk_broom_from_antenna, conical_from_antenna])
@given(a=st.floats(0, 1.5), b=angle)
def test_antenna_axes_are_right_handed_with_left_and_up_at_the_middle_of_the_scan(build, a, b):
    turned, still = build(a, np.array([b, 0.0]))
    np.testing.assert_allclose(turned.T @ turned, np.eye(3), atol=1e-12)
    assert np.linalg.det(turned) == pytest.approx(1.0)
    # Forward-right-down: left is -right; up leans forward as the beam tilts down.
    np.testing.assert_allclose(still[:, 1], [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(still[:, 2], [np.cos(a), 0, -np.sin(a)], atol=1e-12)
