"""Recorded flights: what is put right, what is refused with its time, splines, and the flight over its ground."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flight_logs import HEIGHT, LAT, LON, csv_columns, csv_text, flown, here, regular, write_csv, write_gpx
from sionna_radar.elevation.local_frame import MapFrame, frame_at
from sionna_radar.flight.build import build_navigation, plan_route
from sionna_radar.flight.frames import body_motion, world_from_body
from sionna_radar.flight.log import Attitudes, Positions
from sionna_radar.flight.recorded import attitude_spline, position_spline
from sionna_radar.flight.trajectory import Flight
from sionna_radar.foundation.errors import InputFileError, RadarError, ScenarioError
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.platform import Platform

FLIGHT = flown(regular())


def flat(point_m: np.ndarray) -> np.ndarray:
    return np.where(np.abs(point_m).max(axis=1) < 500, 10.0, np.nan)


def fly(path: Path, frame: MapFrame | None = None, origin_height_m: float = 0.0, **keys: object) -> Flight:
    return plan_route(Platform(log=path, **keys), lambda: frame).fly(flat, 1, origin_height_m)


def as_csv(path: Path, columns: dict[str, np.ndarray]) -> Path:
    path.write_text(csv_text(columns))
    return path


# ------------------------------------------------------------------------------------------ splines


def test_the_flight_is_the_one_that_was_logged(tmp_path):
    """20 Hz samples of a circle: the Hermite spline errs by h^4 max|f''''| / 384, in speed by h^3 / (72 sqrt(3))."""
    flight = fly(write_csv(tmp_path / "a.csv", FLIGHT)).trajectory
    time_s = np.random.default_rng(1).uniform(0.0, flight.end_s, 500)
    true = flown(time_s)
    fourth = 40 * 0.25**4
    assert np.abs(flight.position(time_s) - true.place).max() < 1.05 * 0.05**4 * fourth / 384 + 1e-8
    assert np.abs(flight.velocity(time_s) - true.velocity).max() < 1.05 * 0.05**3 * fourth / (72 * np.sqrt(3)) + 1e-7
    apart = world_from_body(true.euler).transpose(0, 2, 1) @ world_from_body(flight.euler(time_s))
    # A rotation spline has no angular acceleration at its ends: that of the flight, over a step, is off there.
    assert Rotation.from_matrix(apart).magnitude().max() < 3e-5
    assert flight.cruise_s() == pytest.approx((0.0, 20.0))


@pytest.mark.parametrize("rate_hz", [20.0, 50.0])
def test_whole_1e_7_deg_do_not_make_the_velocity_jitter(rate_hz):
    """Rounded by q, positions err by q / 2, and velocities between them by 3 q / (2 h): 0.33 and 0.83 m/s."""
    logged = flown(regular(rate_hz, 40.0))
    grid_m = np.array([0.0075, 0.0111, 0.001])
    rounded = Positions(
        source="", time_s=logged.time_s, place=np.round(logged.place / grid_m) * grid_m, velocity_mps=logged.velocity
    )
    time_s = np.linspace(0.5, 39.5, 4001)
    spline, true = position_spline(rounded, 0.0), flown(time_s)
    assert np.abs(spline(time_s) - true.place).max() < grid_m.max() / 2
    assert np.abs(spline(time_s, 1) - true.velocity).max() < 0.02


def test_positions_that_velocities_do_not_explain_are_flown_as_they_stand():
    """A walk of the positions of their own, and velocities that lag: nothing there is rounding."""
    logged, random = flown(regular()), np.random.default_rng(5)
    walk = np.cumsum(random.normal(size=(401, 3)), axis=0)
    for place, velocity in (
        (logged.place, flown(logged.time_s - 0.2).velocity),
        (logged.place + walk, logged.velocity),
    ):
        positions = Positions(source="", time_s=logged.time_s, place=place, velocity_mps=velocity)
        moved = position_spline(positions, 0.0)(logged.time_s) - place
        assert np.sqrt(np.mean(moved**2)) < 0.1 * np.sqrt(np.mean(np.diff(place - logged.place, axis=0) ** 2)) + 1e-12


def test_velocity_is_the_derivative_of_position_without_velocities_too(tmp_path):
    columns = {key: v for key, v in csv_columns(FLIGHT).items() if not key.startswith("velocity")}
    flight = fly(as_csv(tmp_path / "a.csv", columns)).trajectory
    time_s = np.random.default_rng(2).uniform(0.1, 19.9, 300)
    step = 1e-4
    slope = (flight.position(time_s + step) - flight.position(time_s - step)) / (2 * step)
    np.testing.assert_allclose(slope, flight.velocity(time_s), atol=2e-4)
    assert np.abs(flight.position(time_s) - flown(time_s).place).max() < 2e-3
    # Akima's velocity is continuous where its pieces meet.
    knots = FLIGHT.time_s[1:-1]
    np.testing.assert_allclose(flight.velocity(knots - 1e-9), flight.velocity(knots + 1e-9), atol=1e-6)


def test_a_bad_fix_is_felt_only_beside_it():
    place = FLIGHT.place[::10].copy()
    positions = Positions(source="", time_s=FLIGHT.time_s[::10], place=place)
    bad = replace(positions, place=place + np.eye(len(place))[20][:, None])
    time_s = np.linspace(0, 20, 2001)
    off = np.abs(position_spline(bad, 0.0)(time_s) - position_spline(positions, 0.0)(time_s)).max(axis=1)
    assert off[np.abs(time_s - 10.0) > 1.5 + 1e-9].max() == 0.0  # three steps of half a second


def test_turn_rates_are_those_of_the_flight(tmp_path):
    """A steady turn at constant roll and pitch: the heading's rate in body axes."""
    euler = np.column_stack([np.full(401, 0.3), np.full(401, 0.1), 0.25 * FLIGHT.time_s])
    flight = fly(write_csv(tmp_path / "a.csv", replace(FLIGHT, euler=euler))).trajectory
    rate = body_motion(flight, np.array([4.0, 12.57, 18.0])).turn_rad_s
    expected = 0.25 * np.array([-np.sin(0.1), np.sin(0.3) * np.cos(0.1), np.cos(0.3) * np.cos(0.1)])
    np.testing.assert_allclose(rate, np.tile(expected, (3, 1)), atol=1e-4)


def test_headings_wrap_and_quaternions_of_either_sign_are_the_same(tmp_path):
    columns = csv_columns(FLIGHT, attitude="quaternion")
    flips = np.where(np.arange(401) % 3 == 0, -1.0, 1.0)
    columns |= {key: columns[key] * flips for key in ("qx", "qy", "qz", "qw")}
    flipped = fly(as_csv(tmp_path / "a.csv", columns)).trajectory
    plain = fly(write_csv(tmp_path / "b.csv", FLIGHT)).trajectory
    time_s = np.linspace(12.4, 12.7, 200)  # the heading passes 180 deg at 12.57 s
    np.testing.assert_allclose(world_from_body(flipped.euler(time_s)), world_from_body(plain.euler(time_s)), atol=1e-6)


def test_across_a_long_gap_the_attitude_turns_steadily():
    """RotationSpline would swing beyond both ends here; the shortest turn at a steady rate does not."""
    time_s = np.concatenate([np.arange(0, 1.01, 0.1), np.arange(3, 4.01, 0.1)])
    angle = np.concatenate([np.linspace(0, 1.0, 11), np.linspace(1.2, 0.2, 11)])
    attitudes = Attitudes(source="", time_s=time_s, quaternion=Rotation.from_euler("z", angle[:, None]).as_quat())
    inside = np.linspace(1.0, 3.0, 50)
    heading = attitude_spline(attitudes, 0.0).euler(inside)[:, 2]
    np.testing.assert_allclose(heading, np.linspace(1.0, 1.2, 50), atol=1e-9)


def test_without_attitudes_the_aircraft_is_level_and_heads_where_it_moves(tmp_path):
    flight = fly(write_gpx(tmp_path / "a.gpx", FLIGHT), here(), HEIGHT)
    assert any("no attitude" in warning for warning in flight.warnings)
    time_s = np.linspace(1.0, 19.0, 100)
    euler = flight.trajectory.euler(time_s)
    np.testing.assert_allclose(euler[:, :2], 0.0, atol=1e-12)
    turned = Rotation.from_euler("z", euler[:, 2:] - flown(time_s).euler[:, 2:])
    assert turned.magnitude().max() < 0.01
    assert flight.record["attitudes"] == "course of the positions"


# ------------------------------------------------------------------------------------------ put right


def test_double_and_disordered_rows_are_put_right_and_said(tmp_path):
    columns = csv_columns(FLIGHT)
    order = np.arange(401)
    order[[100, 101]] = 101, 100
    columns = {key: np.insert(column[order], 200, column[200]) for key, column in columns.items()}
    flight = fly(as_csv(tmp_path / "a.csv", columns))
    plain = fly(write_csv(tmp_path / "b.csv", FLIGHT))
    time_s = np.linspace(0, 20, 333)
    np.testing.assert_array_equal(flight.trajectory.position(time_s), plain.trajectory.position(time_s))
    notes = " ".join(flight.record["notes"])
    assert "1 positions are out of order by up to 0.05 s" in notes
    assert "1 positions have the time of the next one" in notes


BAD = {
    "gap": (lambda c: {k: np.delete(v, slice(100, 161)) for k, v in c.items()}, r"at 4\.95 s: no position for 3\.1 s"),
    "clock": (
        lambda c: c | {"time_s": np.where(np.arange(401) > 250, c["time_s"] - 5.0, c["time_s"])},
        r"at 7\.55 s: time runs back by 4\.95 s in row 252 of the positions",
    ),
    "jump": (
        lambda c: c | {"east_m": c["east_m"] + np.where(np.arange(401) > 300, 60.0, 0.0)},
        r"at 15\.05 s: the position jumps by 59\.\d m in 0\.05 s",
    ),
    "spin": (
        lambda c: c | {"heading_deg": c["heading_deg"] + np.where(np.arange(401) > 300, 140.0, 0.0)},
        r"at 15\.05 s: the attitude turns by 1\d\d deg within 0\.05 s",
    ),
    "rest": (
        lambda c: {k: v if k.endswith(("_deg", "time_s")) else 0.0 * v for k, v in c.items()},
        r"vehicle stationary, within 0 m, from 0\.00 to 20\.00 s; it moves nowhere in this log",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_flown_is_refused_with_its_time(name, tmp_path):
    spoil, said = BAD[name]
    path = as_csv(tmp_path / "flight.csv", spoil(csv_columns(FLIGHT)))
    with pytest.raises(InputFileError, match=rf"platform\.log .*flight\.csv.*: {said}"):
        fly(path)


def test_the_part_beside_a_gap_is_flown_and_so_is_a_gap_that_is_allowed(tmp_path):
    path = as_csv(tmp_path / "a.csv", BAD["gap"][0](csv_columns(FLIGHT)))
    late = fly(path, log_start_s=9.0).trajectory
    np.testing.assert_allclose(late.position(np.array([1.0])), flown(np.array([10.0])).place, atol=1e-6)
    assert late.end_s == pytest.approx(11.0)
    assert fly(path, log_stop_s=4.0).trajectory.end_s == pytest.approx(4.0)
    assert fly(path, log_gap_s=4.0).trajectory.end_s == pytest.approx(20.0)


# ------------------------------------------------------------------------------------------ over the ground


def test_heights_in_the_terrain_s_datum_lose_the_height_of_the_local_origin(tmp_path):
    path = write_csv(tmp_path / "a.csv", FLIGHT, on_map=True)
    flight = fly(path, here(), origin_height_m=HEIGHT)
    np.testing.assert_allclose(flight.trajectory.position(np.zeros(1)), [[0.0, 0.0, 50.0]], atol=1e-3)
    assert flight.altitude_m == pytest.approx(np.median(FLIGHT.place[:, 2]) - 10.0, abs=0.05)
    assert any("unknown level" in warning for warning in flight.warnings)
    assert flight.speed_mps == pytest.approx(10.0, rel=1e-3)


def test_a_flight_elsewhere_is_moved_to_the_terrain_and_stands_on_its_take_off(tmp_path):
    columns = csv_columns(FLIGHT, on_map=True)
    flight = fly(as_csv(tmp_path / "a.csv", columns), None, log_shift="to_terrain", log_height=60.0)
    place = flight.trajectory.position(np.linspace(0, 20, 500))
    middle = (place[:, :2].min(axis=0) + place[:, :2].max(axis=0)) / 2
    np.testing.assert_allclose(middle, 0.0, atol=0.02)
    assert place[0, 2] == pytest.approx(70.0, abs=1e-6)
    columns["height_m"][:5] = HEIGHT + 20.0
    columns |= {key: column for key, column in columns.items() if not key.startswith("velocity")}
    late = fly(as_csv(tmp_path / "b.csv", columns), None, log_shift="to_terrain", log_start_s=2.0)
    # 30 m and more above the first position of the log, which stands on the ground at 10 m.
    expected = 10.0 + flown(np.array([2.0])).place[0, 2] - 20.0
    assert late.trajectory.position(np.zeros(1))[0, 2] == pytest.approx(expected, abs=1e-6)


def test_a_plain_shift_moves_the_flight(tmp_path):
    path = write_csv(tmp_path / "a.csv", FLIGHT)
    shifted, plain = fly(path, log_shift=(5.0, -6.0, 7.0)), fly(path)
    time_s = np.linspace(0, 20, 50)
    moved = shifted.trajectory.position(time_s) - plain.trajectory.position(time_s)
    np.testing.assert_allclose(moved, np.tile([5.0, -6.0, 7.0], (50, 1)), atol=1e-9)


@pytest.mark.parametrize(
    ("keys", "error", "said"),
    [
        (
            {"log_shift": (0.0, 0.0, -45.0)},
            ScenarioError,
            r"is \d+\.\d m under the ground at|m under the ground 1\d\.\d s",
        ),
        ({"log_shift": (600.0, 0.0, 0.0)}, ScenarioError, r"has no ground under it 0\.0 s into the log"),
        ({"log_start_s": 30.0}, ScenarioError, r"30 is behind the end of the log, at 20\.0 s"),
        ({"log_start_s": 19.9}, InputFileError, r"has 3 distinct time stamps between 19\.9 and inf s"),
        ({"log_shift": (5e6, 0.0, 0.0)}, ScenarioError, r"5,000 km from the terrain's middle"),
        (
            {"log_shift": (1.0, 2.0)},
            ScenarioError,
            r"log_shift: must be 'none', 'to_terrain' or .*, not \(1\.0, 2\.0\)",
        ),
        ({"log_height": "sea"}, ScenarioError, r"log_height: must be 'datum', 'above_takeoff' or the .*, not 'sea'"),
        ({"log_start_s": 4.0, "log_stop_s": 3.0}, ScenarioError, r"3 is not after log_start_s = 4"),
        ({"altitude_m": 50.0, "heading_deg": 3.0}, ScenarioError, r"log: contradicts altitude_m, heading_deg"),
        ({"wind": {"speed_mps": 3.0}}, ScenarioError, r"log: contradicts wind"),
    ],
)
def test_flights_that_cannot_be_are_refused(keys, error, said, tmp_path):
    path = write_csv(tmp_path / "a.csv", FLIGHT)
    with pytest.raises(error, match=said):
        fly(path, **keys)


def test_a_log_on_the_map_needs_ground_on_the_map(tmp_path):
    path = write_csv(tmp_path / "a.csv", FLIGHT, on_map=True)
    with pytest.raises(ScenarioError, match=r"set log_shift = 'to_terrain', or terrain\.centre_lonlat_deg"):
        fly(path)
    far = frame_at(LON + 20.0, LAT)
    with pytest.raises(ScenarioError, match=r"km from the terrain's middle; is it a log of this place"):
        fly(path, far)


def test_keys_of_a_log_mean_nothing_without_one():
    with pytest.raises(ScenarioError, match=r"log_start_s: has no effect without platform.log"):
        Platform(altitude_m=50.0, speed_mps=10.0, log_start_s=3.0)
    with pytest.raises(ScenarioError) as refused:
        Platform(length_m=5.0)
    assert [problem.field for problem in refused.value.problems] == ["altitude_m", "speed_mps"]


def test_a_shipped_scene_flies_a_log_in_place_of_its_own_flight(tmp_path):
    path = write_csv(tmp_path / "a.csv", FLIGHT)
    scenario = load_scenario("hills", {"platform.log": str(path)})
    assert scenario.platform.altitude_m is None
    assert scenario.platform.log == path
    (tmp_path / "scene.toml").write_text(
        '[terrain]\nkind = "flat"\n[platform]\nlog = "a.csv"\nnavigation = "from_log"\n[radar]\nsnr_db = 30.0\n'
    )
    beside = load_scenario(str(tmp_path / "scene.toml"))
    assert beside.platform.log == path
    assert beside.platform.navigation.kind == "from_log"


# ------------------------------------------------------------------------------------------ its own errors


def sigma_columns(position: float, velocity: float, attitude_deg: float) -> dict[str, np.ndarray]:
    one = np.ones(401)
    columns = {f"sigma_{axis}_m": position * one for axis in ("east", "north", "up")}
    columns |= {f"sigma_velocity_{axis}_mps": velocity * one for axis in ("east", "north", "up")}
    return columns | {f"sigma_{angle}_deg": attitude_deg * one for angle in ("roll", "pitch", "heading")}


def test_errors_from_the_log_have_its_standard_deviations(tmp_path):
    columns = csv_columns(FLIGHT) | sigma_columns(0.2, 0.05, 0.5)
    columns["sigma_up_m"] = np.linspace(0.0, 0.8, 401)
    flight = fly(as_csv(tmp_path / "a.csv", columns)).trajectory
    table = Platform(
        log=tmp_path / "a.csv", navigation={"kind": "from_log", "correlation_s": [0.5, 0.5, 0.5]}
    ).navigation
    index, time_s = np.arange(2000), (np.arange(2000) + 0.5) / 100.0
    drawn = np.array([build_navigation(table, flight, 100.0, seed).errors(index, time_s) for seed in range(40)])
    position, velocity, attitude = drawn.transpose(1, 0, 2, 3)
    # 40 flights of 20 s, correlated over 0.5 s: about 800 independent draws an axis, 2.5 % of a standard deviation.
    np.testing.assert_allclose(position[:, :, :2].std(axis=(0, 1)), 0.2, rtol=0.1)
    np.testing.assert_allclose(velocity.std(axis=(0, 1)), 0.05, rtol=0.1)
    np.testing.assert_allclose(attitude.std(axis=(0, 1)), np.deg2rad(0.5), rtol=0.1)
    growing = position[:, :, 2].std(axis=0)
    assert growing[1500:].mean() / growing[:500].mean() == pytest.approx(0.7 / 0.1, rel=0.15)
    # exp(-t / T) after 0.5 s
    after = np.mean(position[:, 50:, 0] * position[:, :-50, 0]) / np.mean(position[:, :, 0] ** 2)
    assert after == pytest.approx(np.exp(-1), abs=0.08)


def test_errors_from_a_log_that_states_none_are_refused(tmp_path):
    flight = fly(write_csv(tmp_path / "a.csv", FLIGHT)).trajectory
    table = Platform(log=tmp_path / "a.csv", navigation="from_log").navigation
    with pytest.raises(ScenarioError, match=r"platform\.navigation\.kind: 'from_log' needs platform\.log with"):
        build_navigation(table, flight, 100.0, 1)


def test_messages_about_long_logs_stay_short(tmp_path):
    columns = csv_columns(FLIGHT)
    columns["east_m"] = columns["east_m"] + 100.0 * (np.arange(401) % 2)
    with pytest.raises(RadarError) as refused:
        fly(as_csv(tmp_path / "a.csv", columns))
    assert len(str(refused.value)) < 1000
    assert re.search(r"\(399 more\)", str(refused.value))
