"""Errors of the measured pose: closed forms, statistics, and independence of the block size."""

from dataclasses import replace

import numpy as np
import pytest

from sionna_radar.flight.build import build_navigation, build_scan
from sionna_radar.flight.frames import whisk_broom_from_antenna
from sionna_radar.flight.navigation import ErrorComponents, GaussMarkov, InertialErrors
from sionna_radar.flight.pulses import Navigation, PulseSchedule, schedule_pulses
from sionna_radar.flight.trajectory import Phase, Trajectory
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import parse_scenario
from sionna_radar.scenario.platform import NavigationTable
from sionna_radar.scenario.radar import ScanTable

RATE_HZ = 360.0


def flight(seconds: float = 2.0, heading_deg: float = 90.0, turn_deg_s: float = 0.0) -> Trajectory:
    """East at 10 m/s, 50 m up; the nose may turn."""

    def euler(t):
        return np.column_stack([0 * t, 0 * t, np.deg2rad(heading_deg + turn_deg_s * t)])

    return Trajectory(
        position=lambda t: np.column_stack([10 * t, 0 * t, np.full_like(t, 50.0)]),
        velocity=lambda t: np.tile([10.0, 0.0, 0.0], (len(t), 1)),
        euler=euler,
        phases=((Phase.CRUISE, 0.0, seconds),),
    )


def schedule(
    trajectory: Trajectory | None = None, *, scan: dict | None = None, seed: int = 3, **errors: object
) -> PulseSchedule:
    table, trajectory = NavigationTable(**errors), trajectory or flight()
    return schedule_pulses(
        trajectory,
        build_scan(ScanTable(**({"mode": "fixed"} | (scan or {})))),
        RATE_HZ,
        lever_arm_m=table.lever_arm_m,
        navigation=build_navigation(table, trajectory, RATE_HZ, seed),
    )


def all_of(survey: PulseSchedule):
    return survey.pulses(np.arange(len(survey)))


def test_without_errors_the_true_pose_is_reported():
    survey = schedule(lever_arm_m=(0.1, 0.0, 0.2))
    assert survey.navigation is None
    pulses = all_of(survey)
    assert pulses.measured is pulses.true
    assert not NavigationTable().has_errors
    assert not NavigationTable(attitude_correlation_s=3.0).has_errors
    assert NavigationTable(boresight_error_deg=(0.0, 0.0, 0.1)).has_errors


def test_a_tenth_of_a_degree_of_pitch_is_9_cm_of_height():
    """At 45 deg from 50 m the slant range is 70.7 m; turning it by 0.1 deg lifts its end by 70.7 sin(45) 0.1 deg."""
    pulses = all_of(schedule(attitude_constant_deg=(0.0, 0.1, 0.0)))
    slant = 50 * np.sqrt(2)
    true, measured = (pose.position_m + slant * pose.boresight for pose in (pulses.true, pulses.measured))
    np.testing.assert_allclose(true[:, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(measured[:, 2], slant * np.sin(np.pi / 4) * np.deg2rad(0.1), rtol=2e-3)
    assert measured[0, 2] == pytest.approx(0.087, abs=0.001)


def test_a_velocity_error_enters_the_range_rate_by_its_part_along_the_beam():
    for incidence_deg, expected in ((0.0, 0.05), (45.0, 0.05 / np.sqrt(2))):
        pulses = all_of(schedule(scan={"incidence_deg": incidence_deg}, velocity_constant_mps=(0.0, 0.0, -0.05)))
        rate = pulses.true.boresight_range_rate_mps - pulses.measured.boresight_range_rate_mps
        np.testing.assert_allclose(rate, expected, rtol=1e-9)
    # f0 v / (B fm) metres of range: 2.1 cm straight down (Rouveure et al. 2017, section 4.3).
    shift_m = 77e9 * 0.05 / (500e6 * RATE_HZ)
    assert shift_m == pytest.approx(0.021, abs=5e-4)


def test_position_errors_count_east_north_up():
    pulses = all_of(schedule(position_constant_m=(1.0, -2.0, 0.5)))
    off = pulses.measured.position_m - pulses.true.position_m
    np.testing.assert_allclose(off, np.tile([1.0, -2.0, 0.5], (len(pulses), 1)))
    np.testing.assert_allclose(pulses.measured.R_world_antenna, pulses.true.R_world_antenna, atol=1e-15)


def test_a_late_stamp_reports_the_past():
    pulses = all_of(schedule(flight(turn_deg_s=20.0), time_offset_s=0.05))
    off = pulses.measured.position_m - pulses.true.position_m
    # 0.05 s at 10 m/s, before the flight began too.
    np.testing.assert_allclose(off, np.tile([-0.5, 0.0, 0.0], (len(pulses), 1)), atol=1e-9)
    inside = pulses.time_s > 0.05
    true, measured = (np.unwrap(np.arctan2(*pose.boresight[:, :2].T)) for pose in (pulses.true, pulses.measured))
    np.testing.assert_allclose(np.rad2deg(true - measured)[inside], 1.0, atol=1e-6)


def test_the_lever_arm_moves_the_antenna_and_its_error_the_belief():
    survey = schedule(flight(turn_deg_s=30.0), lever_arm_m=(2.0, 0.0, 0.5), lever_arm_error_m=(0.1, 0.0, 0.0))
    pulses = all_of(survey)
    heading = np.deg2rad(90 + 30 * pulses.time_s)
    nose = np.column_stack([np.sin(heading), np.cos(heading), 0 * heading])
    right = np.column_stack([np.cos(heading), -np.sin(heading), 0 * heading])
    ins = survey.trajectory.position(pulses.time_s)
    np.testing.assert_allclose(pulses.true.position_m, ins + 2 * nose - [0, 0, 0.5], atol=1e-9)
    np.testing.assert_allclose(pulses.measured.position_m - pulses.true.position_m, 0.1 * nose, atol=1e-9)
    swing = 2 * np.deg2rad(30) * right
    np.testing.assert_allclose(pulses.true.velocity_mps - [10.0, 0.0, 0.0], swing, atol=1e-5)


def test_an_instantaneous_turn_swings_no_antenna():
    corner = replace(flight(), euler=lambda t: np.column_stack([0 * t, 0 * t, np.where(t < 1.0, 0.0, np.pi / 2)]))
    pulses = all_of(schedule(corner, lever_arm_m=(2.0, 0.0, 0.0)))
    np.testing.assert_allclose(pulses.true.velocity_mps, np.tile([10.0, 0.0, 0.0], (len(pulses), 1)), atol=1e-9)


@pytest.mark.parametrize("stabilised", [True, False])
def test_the_boresight_error_turns_with_the_platform(stabilised):
    scan = {"incidence_deg": 45.0, "stabilised": stabilised}
    pitched = all_of(schedule(scan=scan, boresight_error_deg=(0.0, 0.1, 0.0)))
    expected = whisk_broom_from_antenna(np.deg2rad(45.1), np.zeros(1))[0, :, 0]
    R = pitched.true.R_world_antenna[0] @ whisk_broom_from_antenna(np.deg2rad(45.0), np.zeros(1))[0].T
    np.testing.assert_allclose(pitched.measured.boresight[0], R @ expected, atol=1e-12)


def test_a_stabilised_mount_keeps_the_attitude_error():
    pulses = all_of(schedule(scan={"stabilised": True}, attitude_constant_deg=(1.0, 0.0, 0.0)))
    left, reported = (pose.R_world_antenna[:, :, 1] for pose in (pulses.true, pulses.measured))
    angle = np.arccos(np.einsum("pi,pi->p", left, reported))
    np.testing.assert_allclose(np.rad2deg(angle), 1.0, atol=1e-6)


NOISY = {
    "position_white_m": 0.1,
    "position_markov_m": (0.5, 0.5, 1.0),
    "velocity_white_mps": 0.05,
    "velocity_markov_mps": 0.1,
    "attitude_white_deg": 0.1,
    "attitude_markov_deg": (0.2, 0.2, 0.5),
}


@pytest.mark.parametrize("size", [1, 7, 100])
def test_the_errors_belong_to_the_pulse_whatever_the_block(size):
    survey = schedule(scan={"mode": "whisk_broom"}, **NOISY)
    whole = all_of(survey).measured
    fresh = schedule(scan={"mode": "whisk_broom"}, **NOISY)
    parts = [pulses.measured for pulses in fresh.blocks(size)]
    for name in ("position_m", "velocity_mps", "R_world_antenna"):
        np.testing.assert_array_equal(np.concatenate([getattr(p, name) for p in parts]), getattr(whole, name))
    other = all_of(schedule(scan={"mode": "whisk_broom"}, seed=4, **NOISY)).measured
    assert not np.any(other.position_m == whole.position_m)


def test_white_errors_are_normal_and_independent():
    errors = InertialErrors(
        position=ErrorComponents(white=(1.0, 2.0, 3.0)), attitude=ErrorComponents(white=(0.1, 0.1, 0.1)), seed=1,
        span_s=(0.0, 60.0), step_s=1 / RATE_HZ,
    )  # fmt: skip
    index = np.arange(20_000)
    position, velocity, attitude = errors.errors(index, index / RATE_HZ)
    np.testing.assert_allclose(position.std(axis=0), [1.0, 2.0, 3.0], rtol=0.03)
    np.testing.assert_allclose(position.mean(axis=0), 0.0, atol=0.08)
    assert not velocity.any()
    assert abs(np.corrcoef(position[1:, 0], position[:-1, 0])[0, 1]) < 0.03
    assert abs(np.corrcoef(position[:, 0], attitude[:, 0])[0, 1]) < 0.03


def test_gauss_markov_has_its_variance_and_autocorrelation():
    step, tau = 0.1, 2.0
    processes = [
        GaussMarkov(start_s=0.0, step_s=step, count=4000, correlation_s=tau, seed=seed, channel=1) for seed in range(40)
    ]
    values = np.concatenate([p.values for p in processes], axis=1)  # 120 of them
    assert values.var() == pytest.approx(1.0, abs=0.03)
    assert values[0].var() == pytest.approx(1.0, abs=0.35)  # stationary from the start
    for lag in (1, 10, 20, 40):
        found = np.mean(values[lag:] * values[:-lag])
        assert found == pytest.approx(np.exp(-lag * step / tau), abs=0.04)
    middle = processes[0].at(np.array([0.25, -1.0, 1e9]))
    np.testing.assert_allclose(middle[0], values[2:4, :3].mean(axis=0))
    np.testing.assert_array_equal(middle[1:], values[[0, -1], :3])


def test_pulses_lie_on_the_grid_of_the_process():
    survey = schedule(position_markov_m=1.0, position_correlation_s=0.5)
    off = all_of(survey)
    error = off.measured.position_m - off.true.position_m
    np.testing.assert_allclose(error, survey.navigation._wander[0].values[: len(survey)], atol=1e-9)


def test_a_navigation_of_ones_own_is_a_navigation():
    class Frozen:
        def measure(self, index, time_s, trajectory, R_body_antenna):
            pose = all_of(schedule(trajectory)).true
            return replace(pose, position_m=np.zeros((len(index), 3)))

    assert isinstance(Frozen(), Navigation)
    survey = replace(schedule(), navigation=Frozen())
    assert not all_of(survey).measured.position_m.any()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("position_white_m", -1.0),
        ("attitude_correlation_s", 0.0),
        ("attitude_markov_deg", [0.1, 0.1]),
        ("lever_arm_m", 0.1),
        ("gyro", 1.0),
    ],
)
def test_what_cannot_be_an_error_is_refused(key, value):
    platform = {"altitude_m": 50.0, "speed_mps": 10.0, "navigation": {key: value}}
    with pytest.raises(ScenarioError) as caught:
        parse_scenario({"terrain": {"kind": "flat"}, "platform": platform, "radar": {"snr_db": 30.0}})
    assert all(p.field.startswith(f"platform.navigation.{key}") for p in caught.value.problems)
