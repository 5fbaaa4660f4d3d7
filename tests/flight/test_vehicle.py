"""A vehicle stands on its wheels: height, pitch and roll of planes, and the heading between its axles."""

import numpy as np
import pytest

from sionna_radar.flight.frames import world_from_body
from sionna_radar.flight.trajectory import Track
from sionna_radar.flight.vehicle import on_wheels

WHEELS = (2.7, 1.6)
STRAIGHT = Track(np.array([[0.0, 0.0], [30.0, 40.0]]))


def drive(ground_m, track=STRAIGHT, altitude_m=2.0, speed_mps=5.0):
    return on_wheels(track, speed_mps, altitude_m, WHEELS, ground_m)


@pytest.mark.parametrize("slope", [(0.1, 0.0), (0.0, -0.2), (0.15, 0.1)])
def test_it_stands_upright_on_a_plane(slope):
    east, north = slope
    trajectory = drive(lambda place: place @ np.array(slope))
    time_s = np.linspace(0.5, 9.5, 7)
    normal = np.array([-east, -north, 1.0]) / np.sqrt(1 + east**2 + north**2)
    up = -world_from_body(trajectory.euler(time_s))[:, :, 2]
    assert up == pytest.approx(np.broadcast_to(normal, up.shape), abs=1e-9)
    assert trajectory.position(time_s) @ normal == pytest.approx(np.full(7, 2.0))
    assert np.linalg.norm(trajectory.velocity(time_s)[:, :2], axis=1) == pytest.approx(np.full(7, 5.0), rel=0.03)


def test_a_corner_of_the_track_is_a_smooth_turn_over_the_distance_of_the_axles():
    corner = Track(np.array([[0.0, 0.0], [0.0, 20.0], [20.0, 20.0]]))
    trajectory = drive(lambda place: np.zeros(len(place)), corner)
    heading = np.rad2deg(trajectory.euler(np.linspace(0, 8, 801))[:, 2])
    assert heading[0] == pytest.approx(0.0)
    assert heading[-1] == pytest.approx(90.0)
    turning = np.flatnonzero((heading > 0.01) & (heading < 89.99)) * 0.01 * 5.0
    assert turning[[0, -1]] == pytest.approx([20 - WHEELS[0] / 2, 20 + WHEELS[0] / 2], abs=0.1)
    # In the middle of the corner the axles are half their distance before and behind it.
    assert heading[400] == pytest.approx(45.0, abs=0.5)


def test_the_velocity_is_the_derivative_of_the_place():
    bumps = lambda place: 0.1 * np.sin(place[:, 0] / 3) + 0.05 * np.cos(place[:, 1] / 2)  # noqa: E731
    trajectory, time_s = drive(bumps), np.linspace(1, 9, 50)
    step = 1e-3
    difference = (trajectory.position(time_s + step) - trajectory.position(time_s - step)) / (2 * step)
    assert trajectory.velocity(time_s) == pytest.approx(difference, abs=0.02)
