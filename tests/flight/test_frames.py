"""Frames against elementary rotations written out, and the boresight formulas of Rouveure et al. 2017."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sionna_radar.flight.frames import (
    R_WORLD_NED,
    conical_from_antenna,
    whisk_broom_from_antenna,
    world_from_body,
    world_from_level,
)

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
def test_euler_angles_round_trip(roll, pitch, heading):
    R_ned_body = R_WORLD_NED.T @ world_from_body(np.array([[roll, pitch, heading]]))[0]
    back = Rotation.from_matrix(R_ned_body).as_euler("ZYX")[::-1]
    np.testing.assert_allclose(back, [roll, pitch, heading], atol=1e-6)


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


def test_scan_counts_toward_the_right_of_the_flight():
    # Flying east with the beam 30 deg ahead of nadir; +40 deg of scan looks south, the right-hand side.
    R_world_level = world_from_level(np.deg2rad([[0.0, 0.0, 90.0]]))
    R_level_antenna = whisk_broom_from_antenna(np.deg2rad(30), np.deg2rad([0.0, 40.0]))
    middle, right = (R_world_level @ R_level_antenna)[:, :, 0]
    np.testing.assert_allclose(middle, [0.5, 0, -np.sqrt(0.75)], atol=1e-12)
    across, down = np.sqrt(0.75) * np.sin(np.deg2rad(40)), np.sqrt(0.75) * np.cos(np.deg2rad(40))
    np.testing.assert_allclose(right, [0.5, -across, -down], atol=1e-12)
