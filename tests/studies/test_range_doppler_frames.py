"""Frames of a flight: targets of known place in their maps, files, and what is refused."""

import json

import numpy as np
import pytest
import trimesh

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.range_doppler.document import DOCUMENT
from sionna_radar.studies.range_doppler.study import range_doppler as run_frames

SPARSE = {"tracing.scatterers_per_m2": 10.0}
TARGETS = [
    {"position_m": [0.0, -32.0], "waypoints_m": [[0.0, -20.0]], "speed_mps": 3.0, "rcs_dbsm": -10.0},
    {"position_m": [0.3, -27.0], "rcs_dbsm": -5.0},
]
FAST = {"targets": TARGETS, "radar.chirp_rate_hz": 4000.0}


@pytest.fixture(scope="module")
def flown():
    return run_frames(load_scenario("slar", SPARSE | FAST), chirps=128, frames=3)


def test_targets_have_their_ranges_and_range_rates(flown):
    """One that comes nearer, and one at rest past which the radar flies, to a fraction of a cell."""
    moving, still = flown.targets
    assert moving.range_rate_mps == pytest.approx(-3.0 * 28.1 / np.hypot(28.1, 28.0), abs=0.05)
    for target in (moving, still):
        assert target.found_range_m == pytest.approx(target.range_m, abs=0.1 * flown.last.chirp.range_resolution_m)
        assert target.found_rate_mps == pytest.approx(target.range_rate_mps, abs=0.1 * flown.analyser.rate_cell_mps)


@pytest.mark.parametrize("sweep", ["up", "down"])
def test_a_target_beyond_the_unambiguous_range_rates_is_found_where_the_wrapped_rate_puts_it(sweep):
    """With each wrapping its range is read one cell (half a wavelength times carrier over bandwidth) beside its own."""
    fast = {"position_m": [0.0, -70.0], "waypoints_m": [[0.0, -10.0]], "speed_mps": 24.0, "rcs_dbsm": 5.0}
    changes = {"targets": [fast], "radar.chirp_rate_hz": 5000.0, "radar.sweep": sweep, "terrain.size_m": [200.0, 200.0]}
    flown = run_frames(load_scenario("slar", SPARSE | changes), chirps=64, frames=1)
    (target,) = flown.targets
    cells = (target.found_range_m - target.range_m) / flown.last.chirp.range_resolution_m
    assert cells == pytest.approx(-2.0 if sweep == "up" else 2.0, abs=0.1)
    assert target.found_rate_mps == pytest.approx(target.range_rate_mps, abs=0.5 * flown.analyser.rate_cell_mps)


@pytest.mark.parametrize("sweep", ["up", "down"])
@pytest.mark.parametrize("cells", [0.2, -0.2])
def test_a_target_at_the_end_of_the_range_rates_is_found_on_either_side_of_it(cells, sweep):
    """A fifth of a cell before or beyond it; its bin may be that of the other end."""
    highest_mps = 299_792_458.0 / 77e9 * 5000.0 / 4
    away = {"position_m": [0.0, -28.0], "waypoints_m": [[0.0, -50.0]], "rcs_dbsm": 5.0}
    away["speed_mps"] = np.sqrt(2) * highest_mps * (1 - cells / 32)
    still = {"platform.speed_mps": 0.1, "platform.length_m": 0.004, "platform.start_m": [0.0, 0.0]}
    changes = still | {"targets": [away], "radar.chirp_rate_hz": 5000.0, "radar.sweep": sweep}
    flown = run_frames(load_scenario("slar", SPARSE | changes), chirps=64, frames=1)
    (target,) = flown.targets
    assert np.all(np.abs(flown.movers.range_rate_mps) <= highest_mps)
    assert abs(target.found_rate_mps) == pytest.approx(highest_mps * (1 - 0.2 / 32), abs=0.005 * highest_mps)
    assert target.read_m == pytest.approx(target.found_range_m + flown.last.chirp.doppler_range_s
                                          * target.found_rate_mps, abs=0.05)  # fmt: skip


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_a_range_gate_changes_no_range(sampling):
    """That of 17.3 m, which lies between cells."""
    gated = {"radar.gate_delay_us": 2 * 17.3 / 299.792458, "radar.sampling": sampling}
    seen = run_frames(load_scenario("slar", SPARSE | FAST | gated), chirps=128, frames=1)
    for target in seen.targets:
        assert target.found_range_m == pytest.approx(target.range_m, abs=0.1 * seen.last.chirp.range_resolution_m)


def test_a_body_is_found_by_what_any_part_of_it_returns(tmp_path):
    """The front of a ball, a radius before its middle."""
    trimesh.creation.icosphere(subdivisions=5, radius=1.0).export(tmp_path / "ball.ply")
    body = {"rcs_dbsm": None, "mesh": {"path": str(tmp_path / "ball.ply"), "reflectivity_db": -10.0}, "height_m": 1.0}
    ball = {key: value for key, value in (TARGETS[0] | body).items() if value is not None}
    flown = run_frames(load_scenario("slar", SPARSE | FAST | {"targets": [ball]}), chirps=128, frames=1)
    (target,) = flown.targets
    assert target.found_range_m == pytest.approx(target.range_m - 1.0, abs=0.1 * flown.last.chirp.range_resolution_m)
    assert target.found_rate_mps == pytest.approx(target.range_rate_mps, abs=0.1 * flown.analyser.rate_cell_mps)


def test_what_moves_through_cells_is_new_and_the_ground_is_not(flown):
    row = np.argmin(np.abs(flown.last.range_rate_mps - flown.targets[0].range_rate_mps))
    assert flown.detected[row].any()
    ground = np.abs(flown.last.range_rate_mps) < 0.1
    assert flown.changed[ground].mean() < 0.02
    assert flown.last.power.shape == flown.mean.shape == flown.detected.shape


def test_the_ground_smears_as_the_radar_passes(flown):
    """At 5 m/s, 28 m up and 45 deg: v^2 / r over 32 ms, in cells of half a wavelength over 32 ms."""
    frame_s = 128 / 4000.0
    change_mps = 25.0 / (28.0 * np.sqrt(2)) * frame_s
    assert flown.smear_cells == pytest.approx(change_mps / (flown.last.chirp.wavelength_m / 2 / frame_s), rel=0.05)


def test_files_and_table(flown, tmp_path, capsys):
    files = DOCUMENT.write(flown, tmp_path / "out")
    names = {str(file.relative_to(tmp_path / "out")) for file in files}
    assert {"range_doppler.json", "peaks.csv", "figures/range_doppler.png"} <= names
    document = json.loads((tmp_path / "out" / "range_doppler.json").read_text())
    assert document["chirps"] == 128
    assert len(document["targets"]) == 2
    DOCUMENT.show(flown)
    assert "3 frames of 128 chirps" in capsys.readouterr().out


def test_maps_are_free_of_the_high_pass_and_of_what_leaks(flown):
    """The same peak of the same power, and noise as even as without; a radome that would hide all of it."""
    built = {
        "radar.receiver.high_pass_corner_hz": 300e3,
        "radar.receiver.leakage": [{"delay_ns": 30.0, "level_db": -60.0}],
        "processing.leakage": "subtract",
    }
    found = run_frames(load_scenario("slar", SPARSE | FAST | built), chirps=128, frames=1)
    plain = run_frames(load_scenario("slar", SPARSE | FAST), chirps=128, frames=1)
    assert found.movers.power[0] == pytest.approx(plain.movers.power[0], rel=0.1)
    assert found.targets[1].found_range_m == pytest.approx(plain.targets[1].found_range_m, abs=0.02)
    for low_m, high_m in ((3.0, 8.0), (10.0, 20.0)):
        near = (found.last.range_m > low_m) & (found.last.range_m < high_m)
        level = [np.mean(one.last.power[:, near]) for one in (found, plain)]
        assert level[0] == pytest.approx(level[1], rel=0.3)


@pytest.mark.parametrize(
    ("changes", "asked", "said"),
    [
        ({"tracing.speckle": "per_pulse"}, {}, "tracing.speckle: 'per_pulse' breaks"),
        ({"radar.sweep": "triangular"}, {}, "radar.sweep: 'triangular' has two sweeps"),
        (SPARSE, {"chirps": 2000}, "frames: 8 frames of 2000 chirps are not within"),
        (SPARSE, {"chirps": 2}, "chirps: 2 do not hold the ring of cells .* at least 19"),
    ],
)
def test_what_cannot_be_framed_is_refused(changes, asked, said):
    with pytest.raises(ScenarioError, match=said):
        run_frames(load_scenario("slar", changes), **asked)


def test_a_beam_that_turns_is_refused():
    with pytest.raises(ScenarioError, match="chirps: 64 turn the beam by"):
        run_frames(load_scenario("hills", {"platform.length_m": 20.0, "terrain.spacing_m": 4.0}), frames=1)


ARRAY = {"kind": "array", "elements": [16, 16]}
BACK_AGAIN = {"mode": "electronic", "beams": 5, "scans_per_s": 800.0, "half_swath_deg": 20.0}


@pytest.mark.parametrize(
    ("scan", "chirps", "said"),
    [
        ({"radar.scan.mode": "conical", "radar.scan.half_swath_deg": 180.0}, 181, "chirps: 181 turn the beam by 90"),
        (
            {"radar.scan": BACK_AGAIN, "radar.antenna": ARRAY, "radar.chirp_rate_hz": 4000.0},
            31,
            "31 turn the beam by 40",
        ),
        (
            {"radar.scan.half_swath_deg": 0.3, "radar.chirp_rate_hz": 7200.0},
            24,
            "chirps: 24 go on while the scan pauses",
        ),
    ],
)
def test_a_beam_that_comes_back_within_a_frame_is_refused(scan, chirps, said):
    """The first and the last chirp look the same way: after a whole turn, in the same beam, on either side of a gap."""
    keys = {"platform.length_m": 40.0, "terrain.spacing_m": 4.0}
    with pytest.raises(ScenarioError, match=said):
        run_frames(load_scenario("hills", keys | scan), chirps=chirps, frames=1)


def test_an_ambiguous_target_is_seen_at_its_own_rate_between_two_intervals():
    """It comes nearer by 5.3 m/s; even intervals would show it beyond 3.9 m/s as one that recedes."""
    fast = [TARGETS[0] | {"speed_mps": 9.0, "rcs_dbsm": 0.0}]
    keys = SPARSE | {"targets": fast, "radar.chirp_rate_hz": 4000.0}
    even = run_frames(load_scenario("slar", keys), chirps=64, frames=1)
    seen = run_frames(load_scenario("slar", keys | {"radar.stagger": 0.5}), chirps=64, frames=1)
    (target,) = seen.targets
    assert -5.4 < target.range_rate_mps < -5.2
    assert target.found_rate_mps == pytest.approx(target.range_rate_mps, abs=0.1 * seen.analyser.rate_cell_mps)
    assert target.found_range_m == pytest.approx(target.range_m, abs=0.1 * seen.last.chirp.range_resolution_m)
    assert even.targets[0].range_rate_mps > 0
    assert seen.analyser.highest_rate_mps == pytest.approx(2 * even.analyser.highest_rate_mps)


@pytest.mark.parametrize(
    ("keys", "chirps", "message"),
    [
        ({"radar.stagger": 0.5}, 63, "chirps: 63 are not pairs"),
        ({"radar.stagger": 0.5}, 36, "chirps: 36 do not hold the ring of cells .* at least 38"),
        ({"processing.window": "flattop"}, 64, "processing.window: 'flattop' shares noise"),
        ({"radar.stagger": 0.5, "processing.cfar.kind": "OS"}, 64, "'OS' has no false-alarm rate"),
        ({"processing.average.chirps": 2}, 64, "processing.average.chirps: 2: a frame supports single chirps only"),
    ],
)
def test_frames_that_cannot_be_are_refused(keys, chirps, message):
    with pytest.raises(ScenarioError, match=message):
        run_frames(load_scenario("slar", SPARSE | keys), chirps=chirps, frames=1)
