"""Errors of an instrument: what navigation with these errors reports is undone, to second order."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sionna_radar.flight.build import build_errors, build_navigation, build_scan
from sionna_radar.flight.instrument import UNKNOWNS, InstrumentErrors, believed_motion
from sionna_radar.flight.pulses import schedule_pulses
from sionna_radar.flight.trajectory import Phase, Trajectory
from sionna_radar.scenario.platform import NavigationTable
from sionna_radar.scenario.processing import CalibrationTable
from sionna_radar.scenario.radar import ScanTable

RATE_HZ = 360.0


def flight(turn_deg_s: float = 5.0, seconds: float = 4.0) -> Trajectory:
    """A level circle at 10 m/s whose nose follows the track, with a slow roll and pitch."""
    rate = np.deg2rad(turn_deg_s)

    def heading(t):
        return rate * t

    def position(t):
        radius = 10 / rate
        return np.column_stack([radius * (1 - np.cos(rate * t)), radius * np.sin(rate * t), np.full_like(t, 50.0)])

    return Trajectory(
        position=position,
        velocity=lambda t: 10 * np.column_stack([np.sin(heading(t)), np.cos(heading(t)), 0 * t]),
        euler=lambda t: np.column_stack([0.1 * np.sin(t), 0.05 * np.cos(2 * t), heading(t)]),
        phases=((Phase.CRUISE, 0.0, seconds),),
    )


def reported(stabilised: bool = False, **errors: object):
    scan, trajectory = build_scan(ScanTable(mode="whisk_broom", stabilised=stabilised)), flight()
    table = NavigationTable(**errors)
    navigation = build_navigation(table, trajectory, RATE_HZ, 3)
    schedule = schedule_pulses(trajectory, scan, RATE_HZ, lever_arm_m=table.lever_arm_m, navigation=navigation)
    return schedule.pulses(np.arange(len(schedule))), scan


@pytest.mark.parametrize(
    ("simulated", "errors"),
    [
        ({"boresight_error_deg": (0.5, -0.4, 0.7)}, {"mounting_deg": (0.5, -0.4, 0.7)}),
        ({"lever_arm_error_m": (0.1, -0.2, 0.15)}, {"lever_arm_m": (0.1, -0.2, 0.15)}),
        ({"time_offset_s": 0.005}, {"time_offset_s": 0.005}),
        ({"position_constant_m": (1.0, -2.0, 0.5)}, {"datum_m": (1.0, -2.0, 0.5)}),
        (
            {"velocity_constant_mps": (0.2, -0.1, 0.3), "boresight_error_deg": (0.1, 0.0, 0.0)},
            {"velocity_mps": (0.2, -0.1, 0.3), "mounting_deg": (0.1, 0.0, 0.0)},
        ),
    ],
)
def test_what_navigation_reports_without_its_errors_is_the_true_pose(simulated, errors):
    pulses, scan = reported(**simulated)
    motion = believed_motion(pulses, scan)
    corrected = motion.without(build_errors(CalibrationTable(**errors))).pose
    # The report of a late clock begins before the flight does, with an attitude that stands still.
    inside = motion.within_lines
    wrong, left = (
        max(
            np.abs(pose.position_m - pulses.true.position_m)[inside].max(),
            50 * np.abs(pose.R_world_antenna - pulses.true.R_world_antenna)[inside].max(),
        )
        for pose in (pulses.measured, corrected)
    )
    # Rates are differences over 0.2 s, one-sided at the ends, which leave a few percent of a time offset.
    assert left < 0.06 * wrong
    np.testing.assert_allclose(corrected.velocity_mps[inside], pulses.true.velocity_mps[inside], atol=2e-3)


def test_a_squinting_beam_is_turned_about_the_upward_axis_of_the_antenna():
    pulses, scan = reported()
    motion = believed_motion(pulses, scan)
    corrected = motion.without(InstrumentErrors(squint_rad=0.01)).pose
    turned = motion.pose.R_world_antenna @ Rotation.from_rotvec([0, 0, -0.01]).as_matrix()
    np.testing.assert_allclose(corrected.R_world_antenna, turned, atol=1e-12)


def test_ranges_that_are_read_and_true_ones_are_inverse():
    errors = InstrumentErrors(range_bias_m=0.3, range_scale=1e-3)
    range_m = np.array([10.0, 100.0])
    np.testing.assert_allclose(errors.read_m(range_m), [10.31, 100.4])
    np.testing.assert_allclose(errors.true_m(errors.read_m(range_m)), range_m)


def test_an_instantaneous_turn_parts_two_lines_and_has_no_rate():
    pulses, scan = reported()
    pose = pulses.measured
    later = np.arange(len(pulses)) >= 300
    velocity = np.where(later[:, None], pose.velocity_mps[:, [1, 0, 2]] * [1, -1, 1], pose.velocity_mps)
    motion = believed_motion(replace(pulses, measured=replace(pose, velocity_mps=velocity)), scan)
    assert set(np.diff(motion.line)) == {0, 1}
    assert np.flatnonzero(np.diff(motion.line)) == [299]
    assert np.abs(motion.acceleration_mps2).max() < 2.0


def test_without_a_scan_the_nose_points_along_the_track():
    pulses, _ = reported()
    mount = believed_motion(pulses, None).R_world_mount
    along = pulses.measured.velocity_mps / np.linalg.norm(pulses.measured.velocity_mps, axis=1)[:, None]
    np.testing.assert_allclose(mount[:, :, 0], along, atol=1e-6)
    np.testing.assert_allclose(mount[:, :, 2], np.tile([0.0, 0.0, -1.0], (len(pulses), 1)), atol=1e-12)


def test_every_error_has_a_place():
    for name, unknown in UNKNOWNS.items():
        assert InstrumentErrors.of({name: 1e-3}) != InstrumentErrors(), name
        assert unknown.prior > 0


def test_frames_are_successive_pulses_at_regular_intervals_within_a_line():
    pulses, scan = reported()
    motion = believed_motion(pulses, scan)
    late = 20 * 10 + 3
    motion = motion.rows(np.delete(np.arange(len(motion)), late))
    frames, interval_s = motion.frames(10)
    assert interval_s == pytest.approx(1 / RATE_HZ)
    np.testing.assert_array_equal(np.diff(frames, axis=1), 1)
    np.testing.assert_allclose(np.diff(motion.time_s[frames], axis=1), interval_s, rtol=1e-6)
    # That with the missing pulse is left out, and those at the ends of the line.
    assert 200 not in frames[:, 0]
    assert {190, 210} <= set(frames[:, 0])
    assert motion.within_lines[frames].all()
