"""The flight that a survey writes is the flight that was flown: read back, and flown again."""

import csv

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sionna_radar.flight.flown_track import flown_track
from sionna_radar.readers.logs.reader import read_log
from sionna_radar.report.files.trajectory import START, write_gpx, write_trajectory_csv
from sionna_radar.scenario import load_scenario
from sionna_radar.survey.preparation import Prepared, prepare

FLAT = {"terrain": {"kind": "flat", "size_m": [700.0, 700.0]}}
WINDY = FLAT | {
    "platform.length_m": 30.0,
    "platform.profile": "full",
    "platform.wind": {"speed_mps": 6.0, "from_deg": 40.0},
    "platform.navigation": {"position_white_m": 0.1, "lever_arm_m": [0.3, 0.0, 0.1]},
    "radar.scan.stabilised": False,
}


@pytest.fixture(scope="module")
def windy() -> Prepared:
    return prepare(load_scenario("hills", WINDY))


@pytest.fixture(scope="module")
def on_map() -> Prepared:
    return prepare(load_scenario("jacksboro", {"platform.length_m": 60.0}))


def columns_of(path):
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]}


def test_the_track_is_the_flight_s_at_its_pulses(windy):
    track = flown_track(windy.flight)
    assert np.all(np.diff(track.time_s) > 0)
    assert (track.time_s[0], track.time_s[-1]) == (0.0, windy.flight.trajectory.end_s)
    assert np.diff(track.time_s).max() < 0.11
    at_pulse = track.pulse >= 0
    pulses = windy.flight.pulses(track.pulse[at_pulse])
    np.testing.assert_array_equal(track.time_s[at_pulse], pulses.time_s)
    np.testing.assert_array_equal(track.antenna_m[at_pulse], pulses.true.position_m)
    np.testing.assert_array_equal(track.measured_antenna_m[at_pulse], pulses.measured.position_m)
    assert np.isnan(track.measured_antenna_m[~at_pulse]).all()
    # Without errors of attitude the measured one is the true one.
    turn = Rotation.from_euler("ZYX", track.measured_euler_rad[at_pulse][:, ::-1]).inv()
    turn = turn * Rotation.from_euler("ZYX", track.euler_rad[at_pulse][:, ::-1])
    assert turn.magnitude().max() < 1e-6
    np.testing.assert_allclose(np.linalg.norm(track.antenna_m - track.position_m, axis=1), np.hypot(0.3, 0.1))


def test_a_long_flight_has_few_rows(windy):
    step_s = windy.flight.trajectory.end_s / 10
    assert len(flown_track(windy.flight, step_s)) < 25


def test_a_flight_is_flown_again_from_its_own_csv(windy, tmp_path):
    path = tmp_path / "trajectory.csv"
    write_trajectory_csv(path, flown_track(windy.flight), None)
    start_s, end_s = windy.flight.trajectory.cruise_s()
    log = {"platform.log": str(path), "platform.log_start_s": start_s, "platform.log_stop_s": end_s}
    navigation = {"platform.navigation": WINDY["platform.navigation"], "radar.scan.stabilised": False}
    again = prepare(load_scenario("hills", FLAT | log | navigation))
    assert len(again) == len(windy)
    first, second = windy.flight.sample(200).true, again.flight.sample(200).true
    np.testing.assert_allclose(second.position_m, first.position_m, atol=1e-3)
    np.testing.assert_allclose(second.velocity_mps, first.velocity_mps, atol=0.02)
    assert np.rad2deg(np.arccos(np.clip(np.sum(first.boresight * second.boresight, axis=1), -1, 1))).max() < 0.02


def test_a_straight_flight_is_flown_again_to_a_micrometre(tmp_path):
    keys = FLAT | {"platform.length_m": 12.0}
    flown = prepare(load_scenario("hills", keys))
    write_trajectory_csv(tmp_path / "trajectory.csv", flown_track(flown.flight), None)
    again = prepare(load_scenario("hills", FLAT | {"platform.log": str(tmp_path / "trajectory.csv")}))
    np.testing.assert_allclose(again.flight.time_s, flown.flight.time_s, atol=1e-12)
    every = np.arange(len(flown))
    first, second = flown.flight.pulses(every).true, again.flight.pulses(every).true
    np.testing.assert_allclose(second.position_m, first.position_m, atol=2e-6)
    np.testing.assert_allclose(second.boresight, first.boresight, atol=1e-7)


def test_the_csv_has_the_map_and_what_was_measured(on_map, tmp_path):
    place = on_map.world.scene.georeference
    path = tmp_path / "trajectory.csv"
    write_trajectory_csv(path, flown_track(on_map.flight), place)
    columns = columns_of(path)
    for number, (local, name) in enumerate(
        (("east_m", "easting_m"), ("north_m", "northing_m"), ("up_m", "elevation_m"))
    ):
        np.testing.assert_allclose(columns[name] - columns[local], place.origin_m[number], atol=2e-6)
    assert ((columns["longitude_deg"] > -84.3) & (columns["longitude_deg"] < -84.1)).all()
    known = np.isfinite(columns["pulse"])
    assert 0.2 * len(known) < known.sum() < len(known)  # the radar looks ahead for 100 of 360 deg
    np.testing.assert_allclose(columns["measured_antenna_up_m"][known], columns["up_m"][known])
    log = read_log(path, "log")
    assert (log.on_map, log.attitudes is not None) == (False, True)


def test_the_gpx_is_the_same_flight(on_map, tmp_path):
    gpxpy = pytest.importorskip("gpxpy")
    place = on_map.world.scene.georeference
    path = tmp_path / "trajectory.gpx"
    track = flown_track(on_map.flight, 0.2)
    write_gpx(path, track, place, 'A <valley> & "ridge" \0')
    read = gpxpy.parse(path.read_text(encoding="utf-8"))
    assert read.tracks[0].name == 'A <valley> & "ridge"'
    assert "EGM96 height" in read.description
    points = read.tracks[0].segments[0].points
    assert len(points) == len(track)
    assert points[0].time == START
    assert START.weekday() == 6  # the beginning of a GPS week
    # As long as the flight, by the program's own spherical distances.
    assert read.length_2d() == pytest.approx(60.0, rel=0.005)
    again = prepare(load_scenario("jacksboro", {"platform.log": str(path), "platform.log_height": "datum"}))
    at = track.time_s[1:-1]
    np.testing.assert_allclose(again.plan.flown.trajectory.position(at), track.position_m[1:-1], atol=2e-3)
