"""SLAM of panoramic images: geometry of a turn, registration, loops, what is lost, and a simulated drive."""

from dataclasses import replace

import numpy as np
import pytest

from sionna_radar import load_scenario, panorama, slam
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.radar.chirp import Chirp
from sionna_radar.studies.slam import SlamOptions
from sionna_radar.studies.slam.document import DOCUMENT
from sionna_radar.studies.slam.drift import drift_of
from sionna_radar.studies.slam.registration import Prior, predicted, register
from sionna_radar.studies.slam.surfaces import Peaks, peaks_of, rotation, surfaces_of

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


def test_without_loops_it_drifts_more_and_says_so(ring, found):
    open_ended = slam(ring, SlamOptions(loops=False))
    assert not open_ended.loops
    assert open_ended.sigma[-1, :2].max() > 2 * found.sigma[-1, :2].max()


def test_turns_that_show_nothing_known_are_lost(ring):
    power = ring.power_w[:20].copy()
    power[12:15] = np.random.default_rng(2).exponential(size=power[12:15].shape) * 1e-9
    cut = replace(
        ring,
        power_w=power,
        time_s=ring.time_s[:20],
        scan_rad=ring.scan_rad[:20],
        true=None,
        measured=None,
    )
    seen = slam(cut, SlamOptions(loops=False))
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


def test_gaps_and_too_few_turns_are_refused(ring):
    with pytest.raises(InputFileError, match="three or more"):
        slam(replace(ring, power_w=ring.power_w[:2], time_s=ring.time_s[:2], scan_rad=ring.scan_rad[:2], true=None))
    late = ring.time_s.copy()
    late[20:] += 30.0
    with pytest.raises(InputFileError, match="without gaps"):
        slam(replace(ring, time_s=late))


def test_it_is_written(found, tmp_path):
    names = {path.name for path in DOCUMENT.write(found, tmp_path / "slam")}
    assert {"slam.json", "way.csv", "map.tif"} <= names
    assert len((tmp_path / "slam" / "way.csv").read_text().splitlines()) == 1 + len(found.state)
