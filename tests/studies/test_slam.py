"""SLAM of panoramic images: geometry of a turn, registration, loops, what is lost, and a simulated drive."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from sionna_radar import load_scenario, panorama, slam
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.radar.chirp import Chirp
from sionna_radar.studies.panorama.polar_images import Way
from sionna_radar.studies.slam import SlamOptions
from sionna_radar.studies.slam.covariance import SCALE_SIGMA, YAW_SIGMA_RAD_M, rows_of, state_covariance
from sionna_radar.studies.slam.document import DOCUMENT
from sionna_radar.studies.slam.drift import drift_of
from sionna_radar.studies.slam.odometry import Odometry, measured_odometry, read_odometry
from sionna_radar.studies.slam.registration import PairFactor, Prior, predicted, register
from sionna_radar.studies.slam.study import check_drive
from sionna_radar.studies.slam.surfaces import Peaks, peaks_of, rotation, surfaces_of
from sionna_radar.survey.sensors.radar import Radar

CHIRP = Chirp(carrier_hz=24e9, bandwidth_hz=250e6, rate_hz=200.0, samples=512)


def houses():
    """Return houses at random places beside the road of `ROUND`."""
    rng, tables = np.random.default_rng(3), []
    while len(tables) < 45:
        middle = rng.uniform(-80, 80, 2)
        if np.all(np.abs(middle) < 40) and not np.all(np.abs(middle) < [17, 7]):
            continue
        size = rng.uniform(5, 12, 2)
        tables.append({
            "position_m": middle.round(2).tolist(), "size_m": [*size.round(2).tolist(), 6.0],
            "heading_deg": round(float(rng.uniform(0, 180)), 1),
        })  # fmt: skip
    return tables


ROUND = {
    "buildings": houses(),
    "fences": [],
    "poles": [],
    "terrain": {"kind": "flat", "size_m": [500.0, 500.0]},
    "platform.waypoints_m": [[-28.0, -5.0], [-28.0, 18.0], [28.0, 18.0], [28.0, -18.0], [-28.0, -18.0], [-28.0, 14.0]],
    "platform.turn_radius_m": 12.0,
    "platform.speed_mps": 5.0,
    "radar.chirp_rate_hz": 200.0,
    "tracing.paths_per_pulse": 256,
}


@pytest.fixture(scope="module")
def ring():
    """Images of a drive once around a block and on."""
    return panorama(load_scenario("stadium", ROUND)).images


@pytest.fixture(scope="module")
def found(ring):
    return slam(ring)


@pytest.fixture(scope="module")
def open_ended(ring):
    return slam(ring, SlamOptions(loops=False))


def test_places_of_a_turn_are_those_of_a_vehicle_that_is_integrated_step_by_step():
    twist = np.array([8.0, -1.0, 0.6])
    truth, steps = np.array([20.0, -13.0]), 20000  # ahead and right of the middle of the turn
    since = np.array([-0.45, -0.1, 0.3])
    angles, ranges = [], []
    for end_s in since:
        place, heading = np.zeros(2), 0.0
        for _ in range(steps):
            h = end_s / steps
            place = place + rotation(heading + twist[2] * h / 2) @ twist[:2] * h
            heading += twist[2] * h
        away = rotation(heading).T @ (truth - place)
        angles.append(np.arctan2(away[1], away[0]))
        distance = np.hypot(*away)
        ranges.append(distance + CHIRP.doppler_range_m(np.array([-(away @ twist[:2]) / distance]))[0])
    doppler_s = float(CHIRP.doppler_range_m(np.ones(1))[0])
    peaks = Peaks(range_m=np.array(ranges), angle_rad=np.array(angles), since_s=since, weight=np.ones(3),
                  doppler_s=doppler_s)  # fmt: skip
    assert peaks.places(twist) == pytest.approx(np.broadcast_to(truth, (3, 2)), abs=1e-3)


def test_a_state_is_driven_on_along_its_circle():
    state = np.array([1.0, 2.0, 0.3, 5.0, 0.0, 0.5])
    ahead = predicted(state, 2.0)
    radius = 5.0 / 0.5
    middle = state[:2] + radius * np.array([-np.sin(0.3), np.cos(0.3)])
    assert np.linalg.norm(ahead[:2] - middle) == pytest.approx(radius)
    assert ahead[2] == pytest.approx(1.3)


def test_peaks_stand_on_walls_and_not_on_noise(ring):
    peaks = peaks_of(ring, 10, threshold_db=10.0, near_m=5.0, far_m=100.0)
    assert 100 < len(peaks.range_m) < 2000
    dark = replace(ring, power_w=np.random.default_rng(1).exponential(size=ring.power_w.shape).astype(np.float32))
    # 10 dB over the mean: exp(-10) of 200 x 160 cells, and the means' own scatter.
    assert len(peaks_of(dark, 10, threshold_db=10.0, near_m=5.0, far_m=100.0).range_m) < 40


def test_registration_finds_pose_and_twist(ring, found):
    truth = found.true_state[:, [1, 0, 2, 3, 4, 5]]
    turns = [peaks_of(ring, turn, threshold_db=10.0, near_m=5.0, far_m=100.0) for turn in (20, 21)]
    first, second = (
        surfaces_of(peaks, truth[turn, 3:], size_m=3.5, sigma_m=0.3)
        for turn, peaks in zip((20, 21), turns, strict=True)
    )
    loose = Prior(mean=truth[21] + [0.8, -0.6, 0.03, 0.8, -0.5, 0.02], information=np.eye(6) * 1e-3)
    laid = register(second, first.moved(truth[20, :3]), loose, reach_m=3.5, twist=truth[21, 3:])
    assert laid.state[:2] == pytest.approx(truth[21, :2], abs=0.25)
    assert laid.state[2] == pytest.approx(truth[21, 2], abs=0.01)
    assert laid.state[3:5] == pytest.approx(truth[21, 3:5], abs=0.5)


def test_a_closed_drive_is_found_with_little_drift(found):
    assert found.loops
    assert not found.lost.any()
    assert found.drift.translation < 0.015
    assert found.drift.end_m < 1.0
    error = found.state[:, :2] - found.true_state[:, :2]
    assert np.abs(error).max() < 3.0
    assert np.mean(np.abs(error) < 1.96 * found.sigma[:, :2] + 1e-9) > 0.8


def test_without_loops_it_drifts_more_and_says_so(open_ended, found):
    assert not open_ended.loops
    assert open_ended.sigma[-1, :2].max() > 2 * found.sigma[-1, :2].max()


def begun(images, turns):
    """Return the first turns of a drive."""
    rows = {name: getattr(images, name)[:turns] for name in ("power_w", "time_s", "scan_rad")}
    true = Way(**{one.name: getattr(images.true, one.name)[:turns] for one in fields(Way)})
    return replace(images, **rows, true=true, measured=None)


def test_turns_that_show_nothing_known_are_lost(ring):
    cut = begun(ring, 20)
    power = cut.power_w.copy()
    power[12:15] = np.random.default_rng(2).exponential(size=power[12:15].shape) * 1e-9
    seen = slam(replace(cut, power_w=power, true=None), SlamOptions(loops=False))
    assert seen.lost[12:15].all()
    assert not seen.lost[:12].any()
    assert seen.drift is None


def test_the_way_of_all_chirps_follows_the_states(ring, found):
    way, middle = found.way, found.images.time_s.shape[1] // 2
    assert way.position_m[:, middle, :2] == pytest.approx(found.state[:, :2], abs=0.05)
    steps = np.diff(way.position_m[5, :, :2], axis=0) * 200.0
    assert steps == pytest.approx(way.velocity_mps[5, :-1, :2], abs=0.1)


def test_drift_of_a_way_that_is_stretched_and_bent():
    way = np.arange(0.0, 1001.0, 5.0)
    true = np.column_stack([np.zeros_like(way), way, np.zeros((len(way), 4))])
    stretched = true * [1.0, 1.02, 1, 1, 1, 1]
    assert drift_of(stretched, true).translation == pytest.approx(0.02)
    bent = true.copy()
    bent[:, 2] = 1e-4 * way
    assert drift_of(bent, true).rotation_rad_per_m == pytest.approx(1e-4)


def straight_drive(scores, place):
    """Return states 10 m apart to the north, and factors of each with the one before it."""
    states = np.column_stack([10.0 * np.arange(6), np.zeros((6, 5))])
    one = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.diag([4.0, 4.0, 1e4, 1.0, 1.0, 1.0]))
    # The second turn sees the lateral place of the first, which its heading decides.
    one[7, 8] = one[8, 7] = one[1, 8] = one[8, 1] = 0.0
    lever = np.zeros(12)
    lever[[1, 7, 8]] = 1.0, -1.0, -10.0
    one += 1e4 * np.outer(lever, lever)
    one[1, 1], one[7, 7], one[1, 7], one[7, 1] = 1e4, 1e4, -1e4, -1e4
    factors = [(k + 1, k, PairFactor(information=one, scores=scores, place_m=place, score=1.0)) for k in range(5)]
    known, total = np.zeros((36, 36)), np.zeros((36, 36))
    known[:3, :3] = 1e9 * np.eye(3)
    total += known + 1e-6 * np.eye(36)
    for a, b, factor in factors:
        total[np.ix_(rows_of(a, b), rows_of(a, b))] += factor.information
    return states, factors, csc_matrix(known), total


def test_the_covariance_is_the_sandwich_of_scores_on_the_same_ground():
    rng = np.random.default_rng(4)
    scores, place = rng.normal(size=(3, 12)), np.array([[1.0, 1.0], [2.0, 3.0], [100.0, 1.0]])
    states, factors, known, total = straight_drive(scores, place)
    found = state_covariance(splu(csc_matrix(total)), known, states, factors, share=0.5, view_m=20.0)
    middle = known.toarray()
    for of_cluster in (scores[:2].sum(axis=0), scores[2]):
        whole = np.zeros(36)
        for a, b, _ in factors:
            whole[rows_of(a, b)] += 0.5 * of_cluster
        middle += np.outer(whole, whole)
    # Half the variance of systematic errors is of the whole drive, half of each 20 m of it.
    for there in (lambda m: True, lambda m: m < 20.0, lambda m: 20.0 <= m < 40.0, lambda m: m >= 40.0):
        scale, yaw = np.zeros(36), np.zeros(36)
        for a, b, factor in factors:
            if there(states[b, 0]):
                scale[rows_of(a, b)] += 0.5 * SCALE_SIGMA * 10.0 * factor.information[:, 0]
                yaw[rows_of(a, b)] += 0.5 * YAW_SIGMA_RAD_M * 10.0 * factor.information[:, 2]
        middle += (np.outer(scale, scale) + np.outer(yaw, yaw)) / 2
    whole = np.linalg.inv(total) @ middle @ np.linalg.inv(total)
    for turn in range(6):
        pose = slice(6 * turn, 6 * turn + 3)
        assert found[turn] == pytest.approx(whole[pose, pose], rel=1e-6, abs=1e-12)


def test_a_drive_without_noise_is_known_to_its_systematic_errors():
    states, factors, known, total = straight_drive(np.zeros((1, 12)), np.zeros((1, 2)))
    found = state_covariance(splu(csc_matrix(total)), known, states, factors, share=1.0, view_m=1000.0)
    assert np.sqrt(found[-1, 0, 0]) == pytest.approx(SCALE_SIGMA * 50.0, rel=1e-3)
    assert np.sqrt(found[-1, 2, 2]) == pytest.approx(YAW_SIGMA_RAD_M * 50.0, rel=1e-3)


def test_odometry_is_integrated_between_turns_and_its_slopes_are_those_of_differences():
    time_s = np.linspace(0.0, 10.0, 1001)
    wheel = Odometry(time_s=time_s, speed_mps=2.0 + time_s, yaw_rate_rad_s=np.cos(time_s), speed_sigma_mps=0.3)
    steps = wheel.between(np.array([1.0, 3.0, 5.0]))
    assert steps.way_m == pytest.approx([8.0, 12.0])
    assert steps.turn_rad == pytest.approx(np.diff(np.sin([1.0, 3.0, 5.0])), abs=1e-4)
    assert steps.way_sigma_m == pytest.approx(0.3 * 2.0 / np.sqrt(200))
    rng = np.random.default_rng(1)
    # Where it fits: half the squared residuals bend there as the information says.
    radius, turn = 12.0 / 0.7, 0.7
    at = np.zeros(14)
    at[6:9] = radius * np.sin(turn), radius * (1 - np.cos(turn)), turn
    steps = replace(steps, turn_rad=np.array([0.7, 0.7]))
    information, gradient = steps.factor(1, at[:6], at[6:12], at[12:])
    assert gradient == pytest.approx(np.zeros(14), abs=1e-6 * np.abs(information).max())
    away = 1e-4 * rng.normal(size=14)
    _, there = steps.factor(1, (at + away)[:6], (at + away)[6:12], (at + away)[12:])
    assert there == pytest.approx(information @ away, rel=0.02, abs=0.02 * np.abs(there).max())


@pytest.mark.parametrize(
    ("sweep", "rate_hz", "warned"), [("down", 200.0, True), ("down", 800.0, False), ("up", 200.0, False)]
)
def test_a_falling_sweep_whose_shift_is_long_for_its_turns_is_warned_of(ring, caplog, sweep, rate_hz, warned):
    """0.48 s of 24 GHz, 250 MHz and 200 sweeps a second, over turns of a second; a fourth of it with 800."""
    images = replace(ring, chirp=replace(ring.chirp, sweep=sweep, rate_hz=rate_hz))
    check_drive(images, SlamOptions(), None)
    assert any("a falling sweep" in message for message in caplog.messages) == warned


def test_scale_and_bias_of_odometry_are_found_and_headings_scatter_less(ring, open_ended):
    exact = measured_odometry(ring, speed_sigma_mps=0.1, yaw_rate_sigma_rad_s=0.003)
    wrong = replace(exact, speed_mps=1.02 * exact.speed_mps, yaw_rate_rad_s=exact.yaw_rate_rad_s + 0.01)
    driven = slam(ring, SlamOptions(loops=False), wrong)
    assert open_ended.odometer is None
    # The images tell the scale, as well as is stated: 0.0150 to 0.0173 in five drives around this block.
    assert driven.odometer[0] == pytest.approx(0.02, abs=4 * SCALE_SIGMA)
    assert driven.odometer[1] == pytest.approx(0.01, abs=0.005)
    scatter = [np.diff(way.state[:, 2] - way.true_state[:, 2]).std() for way in (open_ended, driven)]
    assert scatter[1] < 0.5 * scatter[0]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("time_s,speed\n0,1\n1,1\n", "its columns are time_s, speed; give"),
        ("time_s,speed_mps\n0,1\n0,1\n", "times do not increase"),
        ("time_s,speed_mps\n0,1\n1,fast\n", "values are missing"),
        ("", "no header"),
        ("time_s,speed_mps\n", "values are missing"),
        ("time_s,speed_mps\n0,8\n1,-2e8\n", "speed_mps reaches 2e\\+08, more than 150"),
        ("time_s,yaw_rate_rad_s\n0,0\n1,90\n", "yaw_rate_rad_s reaches 90, more than 50"),
    ],
)
def test_odometry_of_another_kind_is_refused(tmp_path, text, match):
    (tmp_path / "wheel.csv").write_text(text)
    with pytest.raises(InputFileError, match=match):
        read_odometry(tmp_path / "wheel.csv", speed_sigma_mps=0.1, yaw_rate_sigma_rad_s=0.01)


def test_odometry_must_span_the_turns(ring):
    with pytest.raises(InputFileError, match="does not span the turns"):
        slam(ring, odometry=Odometry(time_s=np.array([0.0, 1.0]), speed_mps=np.ones(2)))


def test_gaps_and_too_few_turns_are_refused(ring):
    with pytest.raises(InputFileError, match="three or more"):
        slam(replace(ring, power_w=ring.power_w[:2], time_s=ring.time_s[:2], scan_rad=ring.scan_rad[:2], true=None))
    late = ring.time_s.copy()
    late[20:] += 30.0
    with pytest.raises(InputFileError, match="without gaps"):
        slam(replace(ring, time_s=late))


@pytest.mark.parametrize(
    ("drive", "odometry", "said"),
    [
        ({"platform.waypoints_m": [[-104.0, -60.0], [-104.0, -40.0]]}, None, "2 turns: give three or more"),
        ({}, "time_s,speed_mps\n0,8\n3,8\n", "odometry from 0.000 to 3.000 s does not span the turns"),
    ],
)
def test_a_drive_that_tells_no_way_is_refused_before_it(cli, tmp_path, monkeypatch, drive, odometry, said):
    monkeypatch.setattr(Radar, "beat", lambda *_: pytest.fail("the drive began"))
    sets = [f"--set={key}={value}" for key, value in {"fences": [], **drive}.items()]
    if odometry:
        (tmp_path / "wheel.csv").write_text(odometry)
        sets += ["--odometry", tmp_path / "wheel.csv"]
    assert said in cli("slam", "stadium", *sets, "-o", tmp_path / "way", code=2).stderr
    assert not (tmp_path / "way").exists()


def test_surfaces_as_large_as_the_surroundings_are_refused_and_small_ones_warned_of(ring, cli, tmp_path, caplog):
    """With squares of 50 m over images of 138 m, 34 % of all errors lie within 95 %."""
    for surface_m in (17.3, 50.0, 100.0):
        with pytest.raises(ScenarioError, match=r"more than an eighth of the range, 138 m.*give at most 17\.2 m"):
            slam(ring, SlamOptions(surface_m=surface_m))
    with pytest.raises(ScenarioError, match=r"give at most 5 m"):
        slam(ring, SlamOptions(surface_m=6.0, far_m=40.0))
    ring.write(tmp_path / "ring.nc")
    assert "--surface: 100 m is more" in cli("slam", tmp_path / "ring.nc", "--surface", 100, code=2).stderr
    with pytest.raises(InputFileError, match="nothing stands out"):
        slam(ring, SlamOptions(surface_m=1.0))
    assert any("1 m is less than 5 range cells" in message for message in caplog.messages)


@pytest.mark.parametrize("surface_m", [3.0, 10.0])
def test_what_is_stated_holds_for_small_and_large_surfaces(ring, surface_m):
    found = slam(ring, SlamOptions(surface_m=surface_m))
    error = found.state[1:, :2] - found.true_state[1:, :2]
    assert np.abs(error / found.sigma[1:, :2]).max() < 3.0
    assert found.lost.sum() == 0


@pytest.mark.usefixtures("undrawn")
def test_the_folder_of_a_panorama_is_read_and_another_one_refused(ring, cli, tmp_path):
    (tmp_path / "seen").mkdir()
    begun(ring, 12).write(tmp_path / "seen" / "panorama.nc")
    cli("slam", tmp_path / "seen", "--no-loops", "-o", tmp_path / "way")
    assert json.loads((tmp_path / "way" / "slam.json").read_text())["turns"] == 12
    said = cli("slam", tmp_path / "way", "-o", tmp_path / "again", code=2).stderr
    assert "way is a folder without panorama.nc; give the folder that `sionna-radar panorama` wrote" in said


@pytest.mark.usefixtures("undrawn")
def test_it_is_written(ring, tmp_path):
    found = slam(begun(ring, 12))
    assert found.true_state is not None
    names = {path.name for path in DOCUMENT.write(found, tmp_path / "slam")}
    assert {"slam.json", "way.csv", "map.tif"} <= names
    assert len((tmp_path / "slam" / "way.csv").read_text().splitlines()) == 1 + len(found.state)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            ("--set", "radar.bandwidth_hz=1e8"),
            "--set: 'radar.bandwidth_hz' is of a scenario, and the images of ring.nc",
        ),
        (("--seed", "4"), "--seed: 'seed' is of a scenario"),
        (("--speed-sigma", "0.3"), "--speed-sigma: is of the --odometry, and there is none"),
        (("--yaw-rate-sigma", "1"), "--yaw-rate-sigma: is of the --odometry"),
    ],
)
def test_options_without_an_effect_are_refused(ring, cli, tmp_path, options, said):
    ring.write(tmp_path / "ring.nc")
    assert said in cli("slam", tmp_path / "ring.nc", "-o", tmp_path / "way", *options, code=2).stderr
    assert not (tmp_path / "way").exists()
