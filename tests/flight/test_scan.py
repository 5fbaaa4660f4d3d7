"""Scans and the pulses they leave, by the paper's Table 2: incidence, spacing, and the beams of an array."""

import numpy as np
import pytest

from sionna_radar.flight.build import build_scan
from sionna_radar.flight.frames import conical_from_antenna
from sionna_radar.flight.pulses import schedule_pulses
from sionna_radar.flight.scan import Pointing, Scan
from sionna_radar.flight.trajectory import Phase, Trajectory
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.scenario.radar import ElectronicScanTable, ScanTable


def flight(roll_deg: float = 0.0, pitch_deg: float = 0.0, seconds: float = 4.0) -> Trajectory:
    """North at 10 m/s, 50 m up, with a constant attitude."""
    euler = np.deg2rad([roll_deg, pitch_deg, 0.0])
    return Trajectory(
        position=lambda t: np.column_stack([0 * t, 10 * t, np.full_like(t, 50.0)]),
        velocity=lambda t: np.tile([0.0, 10.0, 0.0], (len(t), 1)),
        euler=lambda t: np.tile(euler, (len(t), 1)),
        phases=((Phase.CRUISE, 0.0, seconds),),
    )


def schedule(trajectory: Trajectory | None = None, **scan: object):
    return schedule_pulses(trajectory or flight(), build_scan(ScanTable(**scan)), 360.0)


def test_a_turn_has_180_pulses_two_degrees_apart():
    pulses = schedule(mode="conical", half_swath_deg=180.0).pulses(np.arange(360))
    steps = np.rad2deg(np.mod(np.diff(pulses.scan_rad), 2 * np.pi))
    np.testing.assert_allclose(steps, 2.0, atol=1e-9)
    assert len(schedule(mode="conical", half_swath_deg=180.0)) == 4 * 360


def test_pulses_outside_the_sector_are_dropped():
    survey = schedule(half_swath_deg=50.0)
    scan = np.rad2deg(survey.pulses(np.arange(len(survey))).scan_rad)
    # Pulses lie at odd degrees (half a chirp after the start), 50 of them within 50 deg, for 8 turns.
    np.testing.assert_allclose(np.unique(scan.round(6)), np.arange(-49, 50, 2))
    assert len(survey) == 8 * 50


def test_a_pulse_on_the_edge_of_the_sector_belongs_to_it():
    survey = schedule(half_swath_deg=49.0)
    scan = np.rad2deg(survey.pulses(np.arange(len(survey))).scan_rad)
    assert np.abs(scan).max() == pytest.approx(49.0)
    assert len(survey) == 8 * 50


def test_scan_lines_lie_five_metres_apart():
    survey = schedule(half_swath_deg=50.0)
    pulses = survey.pulses(np.arange(len(survey)))
    same = np.isclose(np.rad2deg(pulses.scan_rad), 21.0)
    np.testing.assert_allclose(np.diff(pulses.true.position_m[same, 1]), 5.0, atol=1e-9)


def test_a_pulse_is_timed_at_the_middle_of_its_chirp():
    survey = schedule(mode="fixed")
    np.testing.assert_allclose(survey.time_s, (np.arange(1440) + 0.5) / 360.0, atol=1e-12)


def test_a_fixed_antenna_keeps_its_direction():
    pulses = schedule(mode="fixed", incidence_deg=30.0, start_deg=20.0).pulses(np.arange(50))
    a, b = np.deg2rad([30.0, 20.0])
    expected = [np.cos(a) * np.sin(b), np.sin(a), -np.cos(a) * np.cos(b)]  # right is east, ahead is north
    np.testing.assert_allclose(pulses.true.boresight, np.tile(expected, (50, 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg", "body_fixed"),
    [
        (0.0, 10.0, (0.0, np.sin(np.deg2rad(10)), -np.cos(np.deg2rad(10)))),  # nose up: the belly looks ahead
        (10.0, 0.0, (-np.sin(np.deg2rad(10)), 0.0, -np.cos(np.deg2rad(10)))),  # right wing down: it looks left
    ],
)
def test_stabilisation_takes_out_roll_and_pitch(roll_deg, pitch_deg, body_fixed):
    moving = flight(roll_deg, pitch_deg)
    levelled = schedule(moving, mode="fixed", incidence_deg=0.0, stabilised=True).pulses(np.arange(3))
    carried = schedule(moving, mode="fixed", incidence_deg=0.0, stabilised=False).pulses(np.arange(3))
    np.testing.assert_allclose(levelled.true.boresight, np.tile([0, 0, -1.0], (3, 1)), atol=1e-12)
    np.testing.assert_allclose(carried.true.boresight, np.tile(body_fixed, (3, 1)), atol=1e-12)


def test_range_rate_of_ground_ahead_is_negative():
    pose = schedule(mode="fixed", incidence_deg=30.0).pulses(np.arange(2)).true
    np.testing.assert_allclose(pose.boresight_range_rate_mps, -10 * np.sin(np.deg2rad(30)), atol=1e-12)


@pytest.mark.parametrize("size", [1, 7, 400, 10_000])
def test_blocks_hold_every_pulse_once_whatever_their_size(size):
    survey = schedule()
    blocks = list(survey.blocks(size))
    assert max(map(len, blocks)) <= size
    np.testing.assert_array_equal(np.concatenate([b.index for b in blocks]), np.arange(len(survey)))
    whole = survey.pulses(np.arange(len(survey)))
    for part in ("position_m", "velocity_mps", "R_world_antenna"):
        joined = np.concatenate([getattr(b.true, part) for b in blocks])
        np.testing.assert_array_equal(joined, getattr(whole.true, part))


@pytest.mark.parametrize("size", [1, 120, 10_000])
def test_blocks_of_lines_never_cut_a_line(size):
    survey = schedule()
    blocks = list(survey.line_blocks(size))
    np.testing.assert_array_equal(np.concatenate([b.index for b in blocks]), np.arange(len(survey)))
    whole = survey.pulses(np.arange(len(survey))).line
    for block in blocks:
        own = whole[block.index]
        assert np.isin(whole, own).sum() == len(block)
        np.testing.assert_array_equal(block.line, own - own[0])
        assert len(block) <= size or own[0] == own[-1]


def test_a_sample_is_spread_from_the_first_pulse_to_the_last():
    survey = schedule()
    index = survey.sample(9).index
    np.testing.assert_array_equal(index * 9 // len(survey), np.arange(9))
    assert (index[0], index[-1]) == (0, len(survey) - 1)
    assert len(survey.sample(10**6)) == len(survey)


@pytest.mark.parametrize("total", [1, 39, 40, 41, 43, 77, 1000])
def test_spread_indices_are_distinct_and_reach_both_ends(total):
    index = spread_indices(40, total)
    assert np.all(np.diff(index) > 0)
    assert min(total, 30) <= len(index) <= 40
    assert (index[0], index[-1]) == (0, total - 1)


@pytest.mark.parametrize("turns", [1, 2, 3, 7.5])
def test_a_sample_meets_all_angles_of_a_scan_whatever_its_step(turns):
    """Every 50th pulse of lines of 50 has one angle; of 40 bins of angle none stays empty."""
    line, count = 50, 400
    found = np.bincount((spread_indices(count, int(count * turns * line)) % line) * 40 // line, minlength=40)
    assert found.min() > 0
    assert found.max() < 3 * count / 40


def test_a_scan_of_ones_own_is_flown():
    class Nodding:
        stabilised = True
        incidence_rad = 0.0

        def point(self, time_s):
            tilt = 0.3 * np.sin(time_s)
            down, none = np.cos(tilt), np.zeros_like(tilt)
            boresight = np.column_stack([np.sin(tilt), none, down])
            left = np.tile([0.0, -1.0, 0.0], (len(tilt), 1))
            R = np.stack([boresight, left, np.cross(boresight, left)], axis=2)
            return Pointing(R, tilt, tilt > 0.1)

        def spacing_m(self, height_m, speed_mps, chirp_rate_hz):
            return speed_mps * 2 * np.pi

    assert isinstance(Nodding(), Scan)
    survey = schedule_pulses(flight(), Nodding(), 100.0)
    pulses = survey.pulses(np.arange(len(survey)))
    assert 0 < len(survey) < 400
    assert np.all(pulses.scan_rad > 0.1)
    np.testing.assert_allclose(pulses.true.boresight[:, 1], np.sin(0.3 * np.sin(survey.time_s)), atol=1e-12)


@pytest.mark.parametrize(("side", "east"), [("right", 1.0), ("left", -1.0)])
def test_a_side_looking_antenna_looks_across_with_its_azimuth_along_the_track(side, east):
    pose = schedule(mode="side_looking", side=side, incidence_deg=60.0).pulses(np.arange(3)).true  # ahead is north
    axes = [[east * np.sin(np.pi / 3), 0.0, -0.5], [0.0, east, 0.0]]
    np.testing.assert_allclose(pose.R_world_antenna[:, :, :2], np.tile(np.transpose(axes), (3, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(pose.boresight_range_rate_mps, 0.0, atol=1e-12)


def test_a_side_looking_antenna_rolls_with_the_body_unless_stabilised():
    moving = flight(roll_deg=10.0)  # right wing down: the right side looks nearer nadir
    for stabilised, incidence in ((True, 45.0), (False, 35.0)):
        pulses = schedule(moving, mode="side_looking", incidence_deg=45.0, stabilised=stabilised).pulses(np.arange(2))
        np.testing.assert_allclose(np.rad2deg(np.arccos(-pulses.true.boresight[:, 2])), incidence, atol=1e-9)


HEIGHT_M, SPEED_MPS, RATE_HZ = 50.0, 10.0, 360.0


def spacing_m(**table: object) -> float:
    return build_scan(ScanTable(**table)).spacing_m(HEIGHT_M, SPEED_MPS, RATE_HZ)


@pytest.mark.parametrize("mode", ["whisk_broom", "conical", "fixed", "side_looking"])
@pytest.mark.parametrize("incidence_deg", [0.0, 35.0, 60.0])
def test_the_incidence_is_the_boresights_in_the_middle_of_the_scan(mode, incidence_deg):
    scan = build_scan(ScanTable(mode=mode, incidence_deg=incidence_deg))
    assert isinstance(scan, Scan)
    assert scan.incidence_rad == pytest.approx(np.deg2rad(incidence_deg))
    down = scan.point(np.zeros(1)).R_mount_antenna[0, 2, 0]
    assert np.arccos(np.clip(down, -1, 1)) == pytest.approx(scan.incidence_rad, abs=1e-7)


@pytest.mark.parametrize("mode", ["fixed", "side_looking"])
def test_a_beam_that_stands_still_moves_with_the_platform(mode):
    assert spacing_m(mode=mode) == pytest.approx(SPEED_MPS / RATE_HZ, rel=1e-12)


@pytest.mark.parametrize("rpm", [6.0, 60.0, 120.0])
def test_lines_of_a_slow_antenna_lie_a_turn_of_flight_apart(rpm):
    assert spacing_m(mode="whisk_broom", incidence_deg=0.0, half_swath_deg=10.0, rotation_rpm=rpm) == pytest.approx(
        SPEED_MPS * 60 / rpm, rel=1e-12
    )


def places_m(scan: Scan, time_s: np.ndarray) -> np.ndarray:
    """Return where the beams of a platform at rest meet level ground, forward and right."""
    boresight = scan.point(time_s).R_mount_antenna[:, :, 0]
    return HEIGHT_M * boresight[:, :2] / boresight[:, 2:]


@pytest.mark.parametrize("incidence_deg", [0.0, 30.0, 45.0])
def test_beams_of_a_fast_whisk_broom_are_no_farther_apart_than_reported(incidence_deg):
    """h / (cos i cos^2 b) times the step of the scan angle b: exact below the track, a bound beside it."""
    scan = build_scan(
        ScanTable(mode="whisk_broom", incidence_deg=incidence_deg, half_swath_deg=50.0, rotation_rpm=3000.0)
    )
    reported = scan.spacing_m(HEIGHT_M, SPEED_MPS, RATE_HZ)
    edge, turn_rad_s, step_s = np.deg2rad(50.0), 100 * np.pi, 1e-8
    expected = HEIGHT_M / np.cos(edge) ** 2 / np.cos(scan.incidence_rad) * turn_rad_s / RATE_HZ
    assert reported == pytest.approx(expected, rel=1e-12)
    for angle in np.linspace(-edge, edge, 41):
        one, other = places_m(scan, (angle + np.array([-0.5, 0.5]) * turn_rad_s * step_s) / turn_rad_s)
        apart_m = np.linalg.norm(other - one) / step_s / RATE_HZ
        assert apart_m <= reported * (1 + 1e-6)
    if incidence_deg == 0:
        assert apart_m == pytest.approx(reported, rel=1e-6)


def test_beams_of_a_fast_cone_lie_on_a_circle():
    """The circle has the radius h tan i, and each chirp turns the antenna by 2 pi rpm / 60 / rate."""
    scan = build_scan(ScanTable(mode="conical", incidence_deg=40.0, half_swath_deg=180.0, rotation_rpm=1200.0))
    reported = scan.spacing_m(HEIGHT_M, SPEED_MPS, RATE_HZ)
    assert reported == pytest.approx(HEIGHT_M * np.tan(np.deg2rad(40.0)) * 2 * np.pi * 20 / RATE_HZ, rel=1e-12)
    one, other = places_m(scan, np.array([0.0, 1e-6]))
    assert reported == pytest.approx(np.linalg.norm(other - one) / 1e-6 / RATE_HZ, rel=1e-4)


def scan_of(**keys):
    return build_scan(ElectronicScanTable(**{"beams": 5, "half_swath_deg": 30.0, "scans_per_s": 2.0, **keys}))


def test_beams_follow_one_another_from_left_to_right():
    pointing = scan_of().point(np.arange(12) / 10 + 0.01)
    np.testing.assert_array_equal(pointing.beam, [0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1])
    np.testing.assert_array_equal(pointing.scan_number, np.arange(12) // 5)
    assert pointing.active.all()
    assert np.all(np.diff(pointing.scan_rad[:5]) > 0)  # scan angles grow to the right
    assert np.rad2deg(pointing.scan_rad[[0, 2, 4]]) == pytest.approx([-30.0, 0.0, 30.0], abs=1e-9)


@pytest.mark.parametrize(("look", "turn_deg"), [("forward", 0.0), ("left", -90.0), ("right", 90.0)])
def test_a_beam_leaves_the_normal_of_the_face_in_its_plane(look, turn_deg):
    scan = scan_of(look=look, incidence_deg=40.0)
    axes = scan.point(np.arange(5) / 10 + 0.01).R_mount_antenna
    face = conical_from_antenna(np.deg2rad(40.0), np.array([np.deg2rad(turn_deg)]))[0]
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (5, 3, 3)), atol=1e-12)
    boresight = axes[:, :, 0]
    np.testing.assert_allclose(boresight @ face[:, 2], 0.0, atol=1e-12)  # in the plane of normal and left
    # Equal steps of direction cosine, from left to right.
    np.testing.assert_allclose(boresight @ face[:, 1], 0.5 * np.linspace(1, -1, 5), atol=1e-12)
    np.testing.assert_allclose(boresight[2], face[:, 0], atol=1e-12)


def test_the_spacing_is_that_of_the_outermost_beams():
    scan = scan_of(incidence_deg=0.0)
    place = 50 * np.tan(np.arcsin(0.5 * np.linspace(1, -1, 5)))
    assert scan.spacing_m(50.0, 1.0, 100.0) == pytest.approx(np.abs(np.diff(place)).max())
    assert scan.spacing_m(50.0, 100.0, 100.0) == pytest.approx(50.0)  # the way flown during a scan
