"""Curved turns, banks, and several lines over one area."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.constants import g as gravity

from sionna_radar.flight.build import build_scan, plan_route
from sionna_radar.flight.pulses import schedule_pulses
from sionna_radar.flight.trajectory import Trajectory
from sionna_radar.flight.turns import CurvedTrack, TurnSegment, rounded_track, shortest_way
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario.platform import LinesTable, Platform
from sionna_radar.scenario.radar import ScanTable

CORNERS = ((0.0, 0.0), (100.0, 0.0), (100.0, 80.0), (0.0, 120.0))
places = st.tuples(
    st.floats(-100, 100), st.floats(-100, 100), st.floats(-np.pi, np.pi, allow_nan=False, allow_infinity=False)
)


def flat(point_m: np.ndarray) -> np.ndarray:
    return np.zeros(len(point_m))


def fly(**keys: object) -> Trajectory:
    platform = Platform(**({"altitude_m": 50.0, "speed_mps": 10.0} | keys))
    return plan_route(platform, lambda: None).fly(flat, 1).trajectory


def lines_of(**keys: object) -> tuple[CurvedTrack, Platform]:
    platform = Platform(**({"altitude_m": 50.0, "speed_mps": 10.0} | keys))
    track = plan_route(platform, lambda: None).track
    assert isinstance(track, CurvedTrack)
    return track, platform


def test_an_arc_is_tangent_to_both_legs_and_keeps_its_radius():
    track = rounded_track(np.array(CORNERS), 15.0)
    along = np.linspace(0.0, track.length_m, 20_001)
    step = along[1]
    point, direction = track.point(along), track.direction(along)
    # Direction is the derivative of position, and never jumps: tangents meet.
    np.testing.assert_allclose(np.diff(point, axis=0) / step, (direction[1:] + direction[:-1]) / 2, atol=2e-3)
    assert np.linalg.norm(np.diff(direction, axis=0), axis=1).max() < 1.01 * step / 15.0
    assert np.hypot(*(point - [85.0, 15.0]).T).min() == pytest.approx(15.0, abs=1e-6)  # the first corner's circle
    # A corner of angle d is cut short by r (2 tan(d/2) - d).
    turns = np.array([np.pi / 2, np.pi / 2 - np.arctan2(40, 100)])
    saved = 15.0 * np.sum(2 * np.tan(turns / 2) - turns)
    legs = sum(np.hypot(*np.subtract(b, a)) for a, b in pairwise(CORNERS))
    assert track.length_m == pytest.approx(legs - saved, abs=1e-9)


def test_bank_and_speed_give_the_radius_and_the_aircraft_banks_into_the_turn():
    flight = fly(waypoints_m=CORNERS, bank_deg=35.0, roll_in_s=1.0)
    radius = 10.0**2 / (gravity * np.tan(np.deg2rad(35.0)))
    time_s = np.linspace(0.0, flight.end_s, 50_001)
    velocity = flight.velocity(time_s)
    acceleration = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / np.diff(time_s)
    assert np.linalg.norm(velocity, axis=1) == pytest.approx(np.full(len(time_s), 10.0), rel=1e-9)
    assert np.median(acceleration[acceleration > 1.0]) == pytest.approx(10.0**2 / radius, rel=1e-3)
    roll, pitch, heading = flight.euler(time_s).T
    assert np.rad2deg(roll.min()) == pytest.approx(-35.0, abs=1e-6)  # to the left: the left wing down
    assert np.all(roll < 1e-12)
    assert not pitch.any()
    np.testing.assert_allclose(np.arctan2(velocity[:, 0], velocity[:, 1]), heading, atol=1e-9)
    assert np.abs(np.diff(roll) / np.diff(time_s)).max() == pytest.approx(np.deg2rad(35.0), rel=1e-3)  # within 1 s


def test_a_roll_averaged_over_the_roll_in_turns_as_far_as_a_sudden_one():
    sudden, gentle = (fly(waypoints_m=CORNERS, turn_radius_m=20.0, roll_in_s=s) for s in (0.0, 2.0))
    time_s = np.linspace(0.0, sudden.end_s, 40_001)
    np.testing.assert_array_equal(sudden.position(time_s), gentle.position(time_s))
    sums = [np.sum(flight.euler(time_s)[:, 0]) * time_s[1] for flight in (sudden, gentle)]
    assert sums[0] == pytest.approx(sums[1], rel=1e-3)


def test_without_a_bank_turns_stay_instantaneous():
    flight = fly(waypoints_m=CORNERS)
    assert not flight.euler(np.linspace(0, flight.end_s, 100))[:, :2].any()
    assert flight.end_s == pytest.approx((100 + 80 + np.hypot(100, 40)) / 10.0)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (
            {"waypoints_m": CORNERS, "turn_radius_m": 60.0},
            r"a radius of 60 m needs 1\d\d m .* leg 2, which has 80; give at",
        ),
        ({"waypoints_m": ((0.0, 0.0), (50.0, 0.0), (0.0, 0.1)), "bank_deg": 30.0}, r"waypoint 1 reverses direction"),
        ({"bank_deg": 30.0, "turn_radius_m": 20.0}, r"contradicts bank_deg"),
        (
            {"lines": {"count": 2, "spacing_m": 5.0, "length_m": 9.0}, "start_m": (0.0, 1.0)},
            r"lines: contradicts start_m",
        ),
    ],
)
def test_turns_that_do_not_fit_are_refused(keys, said):
    with pytest.raises(ScenarioError, match=said):
        fly(**keys)


@given(start=places, end=places, radius_m=st.floats(1.0, 60.0))
def test_the_shortest_way_leads_from_one_place_to_the_other(start, end, radius_m):
    way = shortest_way(start, end, radius_m)
    reached = way[-1].end if way else start
    np.testing.assert_allclose(reached[:2], end[:2], atol=1e-6)
    assert np.cos(reached[2] - end[2]) == pytest.approx(1.0, abs=1e-9)
    for before, after in pairwise(way):
        np.testing.assert_allclose(before.end, (*after.start_m, after.heading_rad), atol=1e-9)
    assert all(abs(segment.curvature_per_m) in (0.0, 1 / radius_m) for segment in way)
    length = sum(segment.length_m for segment in way)
    assert np.hypot(end[0] - start[0], end[1] - start[1]) <= length + 1e-9


@given(place=places, radius_m=st.floats(1.0, 60.0))
@example(place=(0.0, 37.3666239078496, 0.0), radius_m=37.3666239078496)
def test_no_way_leads_to_where_one_is(place, radius_m):
    assert not shortest_way(place, place, radius_m)


def test_ways_known_in_closed_form():
    """Half a circle to a line two radii beside; a bulb of three arcs to one half a radius beside."""
    half = shortest_way((0.0, 0.0, 0.0), (20.0, 0.0, np.pi), 10.0)
    assert sum(segment.length_m for segment in half) == pytest.approx(np.pi * 10.0)
    bulb = shortest_way((0.0, 0.0, 0.0), (5.0, 0.0, np.pi), 10.0)
    out = np.arccos((2.5 + 10.0) / 20.0)
    assert sorted(s.length_m for s in bulb) == pytest.approx(sorted([out * 10, out * 10, (np.pi + 2 * out) * 10]))


def test_lines_are_straight_parallel_and_flown_to_and_fro():
    keys = {"lines": {"count": 3, "spacing_m": 12.0, "length_m": 80.0, "centre_m": (5.0, -3.0)}, "heading_deg": 30.0}
    track, _ = lines_of(**keys, bank_deg=30.0, roll_in_s=1.0)
    lines = [segment for segment in track.segments if segment.on_line]
    assert [segment.length_m for segment in lines] == pytest.approx([80.0] * 3)
    right = np.array([np.cos(np.deg2rad(30.0)), -np.sin(np.deg2rad(30.0))])
    middles = [(np.array(line.start_m) + line.end[:2]) / 2 - [5.0, -3.0] for line in lines]
    np.testing.assert_allclose([m @ right for m in middles], [-12.0, 0.0, 12.0], atol=1e-9)
    np.testing.assert_allclose(np.cos([line.heading_rad - np.deg2rad(30.0) for line in lines]), [1, -1, 1], atol=1e-9)
    for before, after in pairwise(track.segments):
        np.testing.assert_allclose(before.end[:2], after.start_m, atol=1e-9)
        assert np.cos(before.end[2] - after.heading_rad) == pytest.approx(1.0)


def test_crossing_lines_are_at_right_angles_over_the_same_area():
    table = {"count": 3, "spacing_m": 30.0, "length_m": 100.0, "crossing": True}
    track, _ = lines_of(lines=table)
    lines = [segment for segment in track.segments if segment.on_line]
    assert len(lines) == 6
    cross = np.cos([line.heading_rad - lines[0].heading_rad for line in lines])
    np.testing.assert_allclose(np.abs(cross), [1, 1, 1, 0, 0, 0], atol=1e-9)
    middle = np.mean([np.add(line.start_m, line.end[:2]) / 2 for line in lines], axis=0)
    np.testing.assert_allclose(middle, 0.0, atol=1e-9)


@pytest.mark.parametrize("bank_deg", [None, 30.0])
def test_the_radar_transmits_on_the_lines_and_in_turns_only_if_asked(bank_deg):
    table = {"count": 2, "spacing_m": 20.0, "length_m": 40.0}
    scan = build_scan(ScanTable(mode="whisk_broom"))
    flights = [fly(lines=table | {"transmit_in_turns": turns}, bank_deg=bank_deg) for turns in (False, True)]
    quiet, loud = (schedule_pulses(flight, scan, 500.0) for flight in flights)
    assert len(loud) > len(quiet)
    for schedule, everywhere in ((quiet, False), (loud, True)):
        place = schedule.sample(10_000).true.position_m
        off_line = (np.abs(np.abs(place[:, 1]) - 10.0) > 1e-6) | (np.abs(place[:, 0]) > 20.0)
        assert off_line.any() == everywhere
    assert np.ptp(quiet.time_s) > 8.0  # both lines


def test_lines_are_checked():
    with pytest.raises(ScenarioError, match="count"):
        LinesTable(count=0, spacing_m=3.0, length_m=5.0)
    assert TurnSegment(start_m=(0.0, 0.0), heading_rad=0.0, length_m=2.0).end == pytest.approx((0.0, 2.0, 0.0))
