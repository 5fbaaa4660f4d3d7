"""Poses that arrive one by one: what is between them, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sionna_radar.flight.frames import world_from_body
from sionna_radar.flight.trajectory import Phase, Trajectory
from sionna_radar.foundation.errors import PoseError
from sionna_radar.studies.live.poses import Poses, PoseTrack

PLANNED = Trajectory(
    position=lambda t: np.column_stack([t, 0 * t, 50 + 0 * t]),
    velocity=lambda t: np.tile([1.0, 0.0, 0.0], (len(t), 1)),
    euler=lambda t: np.zeros((len(t), 3)),
    phases=((Phase.CRUISE, 0.0, 10.0),),
)


def made(time_s, seed=0):
    random = np.random.default_rng(seed)
    return Poses.of(
        time_s,
        random.normal(size=(len(time_s), 3)),
        random.uniform(-1, 1, (len(time_s), 3)),
        random.normal(size=(len(time_s), 3)),
        random.normal(size=(len(time_s), 3)),
    )


def track_of(*parts, kept_s=100.0):
    track = PoseTrack(kept_s, PLANNED)
    for part in parts:
        track.append(part)
    return track.trajectory


@given(st.lists(st.floats(0.01, 1.0), min_size=1, max_size=8), st.integers(0, 99))
def test_at_its_time_a_pose_returns_bit_for_bit(steps, seed):
    poses = made(np.cumsum(steps), seed)
    trajectory = track_of(poses)
    for column, of in (
        (poses.position_m, trajectory.position),
        (poses.velocity_mps, trajectory.velocity),
        (poses.euler_rad, trajectory.euler),
        (poses.turn_rad_s, trajectory.turn),
    ):
        np.testing.assert_array_equal(of(poses.time_s), column)


def test_a_cubic_is_met_exactly_and_velocity_is_its_derivative():
    c = np.array([[1.0, -2.0, 0.5], [3.0, 0.2, -1.0], [0.4, 1.0, 2.0], [-0.3, 0.1, 0.7]])
    at = lambda t: sum(c[k] * t[:, None] ** k for k in range(4))  # noqa: E731
    rate = lambda t: sum(k * c[k] * t[:, None] ** (k - 1) for k in range(1, 4))  # noqa: E731
    time_s = np.array([0.0, 0.7, 1.0, 2.5])
    trajectory = track_of(Poses.of(time_s, at(time_s), np.zeros((4, 3)), rate(time_s)))
    between = np.linspace(0.0, 2.5, 57)
    np.testing.assert_allclose(trajectory.position(between), at(between), atol=1e-12)
    np.testing.assert_allclose(trajectory.velocity(between), rate(between), atol=1e-12)


def test_attitudes_turn_the_short_way_at_a_constant_rate():
    heading = np.deg2rad([350.0, 10.0])
    euler = np.column_stack([np.zeros((2, 2)), heading])
    poses = Poses.of([0.0, 2.0], np.zeros((2, 3)), euler)
    np.testing.assert_allclose(np.rad2deg(poses.turn_rad_s), [[0, 0, 10], [0, 0, 10]], atol=1e-9)
    turned = np.rad2deg(track_of(poses).euler(np.array([0.5, 1.0, 1.5])))[:, 2]
    np.testing.assert_allclose((turned + 180) % 360 - 180, [-5.0, 0.0, 5.0], atol=1e-9)


def test_missing_velocities_and_turns_are_the_mean_ones_since_the_pose_before():
    first = Poses.of(0.0, [0.0, 0.0, 10.0], [0.0, 0.0, 0.0])
    second = Poses.of(0.5, [1.0, 2.0, 10.0], [0.1, 0.0, 0.0], before=first)
    assert first.velocity_mps.tolist() == [[0.0, 0.0, 0.0]]
    assert second.velocity_mps.tolist() == [[2.0, 4.0, 0.0]]
    np.testing.assert_allclose(second.turn_rad_s, [[0.2, 0.0, 0.0]], atol=1e-12)


def test_a_rotation_matrix_is_its_angles():
    euler = np.array([[0.1, -0.2, 2.0], [0.0, 0.3, -1.0]])
    poses = Poses.of([0.0, 1.0], np.zeros((2, 3)), world_from_body(euler))
    np.testing.assert_allclose(poses.euler_rad, euler, atol=1e-12)
    one = Poses.of(0.0, [0.0, 0.0, 0.0], world_from_body(euler[:1])[0])
    np.testing.assert_allclose(one.euler_rad, euler[:1], atol=1e-12)


def test_before_the_first_pose_the_planned_flight_counts_and_beyond_the_last_its_velocity():
    track = PoseTrack(1.0, PLANNED)
    assert track.trajectory.position(np.array([3.0])).tolist() == [[3.0, 0.0, 50.0]]
    track.append(Poses.of(2.0, [0.0, 0.0, 9.0], [0.0, 0.0, 0.0], [1.0, 2.0, 3.0]))
    assert track.trajectory.position(np.array([1.5, 2.0, 2.5])).tolist() == [[-0.5, -1, 7.5], [0, 0, 9], [0.5, 1, 10.5]]


def test_only_what_later_steps_need_is_kept():
    track = PoseTrack(0.5, PLANNED)
    for step in range(1000):
        track.append(Poses.of(0.1 * step, [0.1 * step, 0.0, 9.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]))
    assert len(track._poses) <= 8
    assert track.trajectory.position(np.array([99.5]))[0, 0] == pytest.approx(99.5)


def test_poses_that_come_out_of_order_are_refused_by_their_track():
    track = PoseTrack(1.0, PLANNED)
    track.append(Poses.of(2.0, [0.0, 0.0, 9.0], [0.0, 0.0, 0.0]))
    with pytest.raises(PoseError, match="2 s is not after 2 s"):
        track.append(Poses.of(2.0, [0.0, 0.0, 9.0], [0.0, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("poses", "said"),
    [
        ({"time_s": [0.0, 0.0]}, "not after"),
        ({"time_s": [1.0, 0.5]}, "not after"),
        ({"time_s": [0.0, np.nan]}, "finite"),
        ({"position_m": [[0.0, 0.0, np.inf], [0, 0, 1]]}, "finite"),
        ({"position_m": [[0.0, 0.0, 1.0]]}, "position_m"),
        ({"velocity_mps": np.zeros((3, 3))}, "velocity_mps"),
        ({"attitude": np.zeros((2, 3, 3))}, "no rotation"),
        ({"attitude": [np.diag([1.0, 1.0, -1.0])] * 2}, "no rotation"),
        ({"velocity_mps": np.full((2, 3), 1e300)}, "velocity_mps: must lie within 1e"),
        ({"position_m": [["here", 0, 0], [0, 0, 0]]}, "position_m: is not made of real numbers"),
        ({"time_s": [], "position_m": np.zeros((0, 3)), "attitude": np.zeros((0, 3))}, "time_s: is empty"),
        ({"attitude": [0.0, 0.0, 0.0]}, "attitude"),
    ],
)
def test_impossible_poses_are_refused(poses, said):
    given = {"time_s": [0.0, 1.0], "position_m": np.zeros((2, 3)), "attitude": np.zeros((2, 3))} | poses
    with pytest.raises(PoseError, match=said):
        Poses.of(**given)
