"""Targets that move, turn and look different from different sides."""

import numpy as np
import pytest
from scipy.special import jv

from beams import make_chirp
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.scene.motion import RcsTable, Rotor, Way
from sionna_radar.scene.objects import read_rcs
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.paths import FIRST_OBSTACLE
from targets import over_target, target_paths

C = 299_792_458.0


def test_a_way_is_gone_along_at_one_speed():
    way = Way(corner_m=np.array([[0.0, 0, 1], [3, 0, 1], [3, 4, 1]]), speed_mps=2.0)
    place, velocity = way.at(np.array([0.0, 1.0, 2.5, 10.0]))
    np.testing.assert_allclose(place, [[0, 0, 1], [2, 0, 1], [3, 2, 1], [3, 4, 1]], atol=1e-12)
    np.testing.assert_allclose(velocity, [[2, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(np.rad2deg(way.heading_rad(np.array([1.0, 2.5, 10.0]))), [90.0, 0.0, 0.0], atol=1e-9)
    round_trip = Way(corner_m=np.array([[0.0, 0, 0], [3, 0, 0], [0, 0, 0]]), speed_mps=1.0, closed=True)
    np.testing.assert_allclose(round_trip.at(np.array([7.0, 11.0]))[0][:, 0], [1.0, 1.0], atol=1e-12)


def test_ranges_and_range_rates_are_those_of_the_motion():
    """A car under the radar, both moving: the range rate is the slope of the ranges."""
    target = {"position_m": [-8.0, -3.0], "height_m": 1.0, "rcs_dbsm": 10.0, "swerling": 0}
    target |= {"waypoints_m": [[8.0, 5.0]], "speed_mps": 12.0}
    block, paths = target_paths(over_target(target), np.arange(0, 400))
    assert len(paths) == 400
    assert np.all(paths.surface == FIRST_OBSTACLE)
    range_m = paths.delay_s * C / 2
    slope = np.gradient(range_m, block.time_s)
    np.testing.assert_allclose(paths.range_rate_mps[1:-1], slope[1:-1], atol=0.01)
    toward = np.array([16.0, 8.0]) / np.hypot(16.0, 8.0)
    np.testing.assert_allclose(
        paths.hit_m[-1, :2], np.array([-8.0, -3.0]) + 12.0 * block.time_s[-1] * toward, atol=1e-6
    )


def test_a_turning_point_gives_bessel_lines():
    """Over whole turns the echo exp(j b cos(w t)) has lines of power J_n(b)^2, b = 4 pi radius / wavelength."""
    rotor = {"radius_m": 0.0012, "rotation_rpm": 600.0, "blades": 1, "points": 1, "rcs_dbsm": 20.0, "axis": "forward"}
    target = {"position_m": [0.0, 0.0], "height_m": 1.0, "rcs_dbsm": -100.0, "rotors": [rotor]}
    scenario = over_target(target, speed_mps=1e-6, length_m=1e-6)
    _, paths = target_paths(scenario, np.arange(360))
    tip = np.abs(paths.gain) > 0.5 * np.abs(paths.gain).max()
    assert tip.sum() == 360
    phase = 2 * np.pi * 77e9 * paths.delay_s[tip]
    lines = np.abs(np.fft.fft(np.exp(-1j * (phase - phase.mean()))) / 360) ** 2
    bend = 4 * np.pi * 77e9 / C * 0.0012
    turns = 10  # in the second that 360 chirps take
    for n in range(7):
        assert lines[n * turns] == pytest.approx(jv(n, bend) ** 2, abs=2e-3)
    assert lines.sum() == pytest.approx(1.0)
    assert np.abs(paths.range_rate_mps[tip]).max() == pytest.approx(
        2 * np.pi * 10 * 0.0012, rel=0.01
    )  # 36 times a turn


def test_blades_turn_about_their_axis():
    rotor = Rotor(
        offset_m=(1.0, 2.0, 3.0), axis=(0.0, 0.0, 1.0), radius_m=0.5, turns_per_s=2.0, blades=2, points=4, rcs_m2=1.0
    )
    time_s, north = np.array([0.0, 0.1, 0.125]), np.zeros(3)
    place, speed = rotor.at(time_s, north)
    hub = np.array([2.0, 1.0, 3.0])  # heading north, right is east
    np.testing.assert_allclose(np.linalg.norm(place - hub, axis=2)[:, [3, 7]], 0.5)
    np.testing.assert_allclose(place[:, 3] + place[:, 7], 2 * hub[None].repeat(3, axis=0), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(speed[:, 3], axis=1), 2 * np.pi * 2 * 0.5)
    step_s = 1e-6
    later = rotor.at(time_s + step_s, north)[0]
    np.testing.assert_allclose((later - place) / step_s, speed, atol=1e-3)


def test_a_cross_section_depends_on_the_side_from_which_it_is_seen():
    """A target heading east, seen from the north: from its left, 270 deg clockwise from its front."""
    table = RcsTable(
        azimuth_rad=np.deg2rad([0.0, 90.0, 180.0, 270.0]),
        elevation_rad=np.deg2rad([0.0, 60.0]),
        rcs_m2=np.array([[1.0, 2.0, 3.0, 4.0], [10.0, 20.0, 30.0, 40.0]]),
    )
    east, from_north = np.array([np.pi / 2]), np.array([[0.0, 1.0, 0.0]])
    assert table.toward(from_north, east)[0] == pytest.approx(4.0)
    assert table.toward(np.array([[1.0, 0.0, 0.0]]), east)[0] == pytest.approx(1.0)
    between = np.array([[np.sin(np.pi / 4), np.cos(np.pi / 4), 0.0]])  # 315 deg
    assert table.toward(between, east)[0] == pytest.approx(2.0)  # the mean of 4 and 1 in decibels
    steep = np.array([[0.0, np.cos(np.pi / 2.2), np.sin(np.pi / 2.2)]])
    assert table.toward(steep, east)[0] == pytest.approx(40.0)


def test_a_table_of_cross_sections_is_read(tmp_path):
    file = tmp_path / "rcs.csv"
    file.write_text("# a box\nazimuth_deg,rcs_dbsm\n0,10\n90,0\n180,10\n270,0\n")
    np.testing.assert_allclose(read_rcs(file).rcs_m2, [[10.0, 1.0, 10.0, 1.0]])
    target = {"position_m": [0.0, 0.0], "rcs_table": str(file), "heading_deg": 90.0}
    _, paths = target_paths(over_target(target), np.arange(3))
    assert len(paths) == 3
    for text in ("azimuth_deg,rcs\n0,1\n", "azimuth_deg,rcs_dbsm\n0,1\n0,2\n", "azimuth_deg,rcs_dbsm\n0,nan\n", ""):
        file.write_text(text)
        with pytest.raises(InputFileError, match="rcs"):
            read_rcs(file)


MOVING = {"waypoints_m": [[5.0, 0.0]], "speed_mps": 3.0}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"rcs_dbsm": None}, "one of rcs_dbsm, rcs_table and mesh"),
        ({"speed_mps": 3.0}, "motion needs both"),
        ({"closed": True}, "closed"),
        (MOVING | {"heading_deg": 3.0}, "a moving target, which looks ahead"),
        (MOVING | {"waypoints_m": [[0.0, 0.0]]}, "two successive waypoints are equal"),
        (MOVING | {"waypoints_m": [[500.0, 0.0]]}, "leaves the terrain"),
        ({"rotors": [{"radius_m": 0.1, "rotation_rpm": 6000.0, "rcs_dbsm": -20.0}]}, "raise radar.chirp_rate_hz"),
    ],
)
def test_what_cannot_move_so_is_refused(changes, says):
    with pytest.raises(ScenarioError, match=says):
        prepare(over_target({"position_m": [0.0, 0.0], "rcs_dbsm": 0.0} | changes))


def test_the_chirp_rate_that_is_asked_for_is_enough():
    rotor = {"radius_m": 0.1, "rotation_rpm": 6000.0, "rcs_dbsm": -20.0}
    prepare(over_target({"position_m": [0.0, 0.0], "rcs_dbsm": 0.0, "rotors": [rotor]}, rate_hz=8000.0, length_m=0.01))
    assert make_chirp().rate_hz < 8000.0
