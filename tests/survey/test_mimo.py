"""A module with an array that maps without turning, from a scenario to a DEM with its uncertainty."""

import numpy as np
import pytest

from sionna_radar import load_scenario, prepare, run
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.survey.observation import segments_of
from sionna_radar.survey.warnings import array_warnings

LOW = {
    "sensor": "mimo",
    "radar": {"preset": "ti_awr1843_array", "array": {"chirps": 32}},
    "platform.altitude_m": 20.0,
    "platform.length_m": 8.0,
    "tracing.paths_per_pulse": 3000,
    "dem.max_gap_m": 3.0,
}


@pytest.fixture(scope="module")
def survey():
    return run(load_scenario("hills", LOW))


def heights_at(prepared, place_m):
    return prepared.world.caster.from_above(place_m[:, :2], float(prepared.world.scene.bounds_m[1, 2]) + 10.0)


def test_a_fixed_module_maps_a_swath(survey):
    points = survey.points
    assert survey.pulses == 8
    assert len(points) > 200
    across_m = np.abs(points.position_m[:, 1])
    assert np.quantile(across_m, 0.9) > 5.0
    assert survey.lit_error.rms_m < 0.4
    assert survey.lit_error.coverage > 0.2


def test_points_scatter_as_they_state(survey):
    points = survey.points
    away = points.position_m - points.origin_m
    steep = np.abs(away[:, 2]) / points.range_m
    stated = np.hypot(points.range_sigma_m * steep, points.across_sigma_m * np.sqrt(1 - steep**2))
    error = points.position_m[:, 2] - heights_at(survey.prepared, points.position_m)
    robust = 1.4826 * np.median(np.abs(error / stated))
    assert 0.6 < robust < 1.6
    assert np.mean(np.abs(error) > 6 * stated) < 0.02


def test_the_dem_states_its_error(survey):
    error, sigma = survey.error.height_m, survey.dem_sigma.height_m
    both = np.isfinite(error) & np.isfinite(sigma)
    assert 0.5 < np.sqrt(np.mean(error[both] ** 2)) / np.sqrt(np.mean(sigma[both] ** 2)) < 2.0


def test_blocks_change_nothing(survey):
    prepared = survey.prepared
    some = prepared.observe(np.array([3, 4])).echoes
    alone = prepared.observe(np.array([4])).echoes
    assert some.of_pulses(np.array([4])).range_m.tolist() == alone.range_m.tolist()
    assert alone.direction.tolist() == some.rows(some.pulse == 4).direction.tolist()


def test_memory_holds_a_few_frames_however_long_the_flight(survey):
    """Blocks are as many chirps as those of single pulses are, or one frame."""
    for size, frames in ((256, 2), (32, 1)):
        blocks = [block for segment in segments_of(survey.prepared, size) for block in segment]
        assert [first for first, _ in blocks] == list(range(0, 8, frames))
        assert [end for _, end in blocks] == list(range(frames, 9, frames))


def test_a_flat_plane_is_flat():
    """Points of a plane against the plane, whatever tells the transmitters apart."""
    changes = LOW | {"terrain": {"kind": "flat", "size_m": [200.0, 200.0]}, "platform.length_m": 2.0}
    found = []
    for code in ("tdm", "bpm"):
        radar = LOW["radar"] | {"array": {"chirps": 16, "multiplexing": code}}
        points = run(load_scenario("hills", changes | {"radar": radar})).points
        scatter = 1.4826 * np.median(np.abs(points.position_m[:, 2]))
        assert scatter < 0.3
        # Four standard errors of a median.
        assert abs(np.median(points.position_m[:, 2])) < 4 * 1.25 * scatter / np.sqrt(len(points))
        found.append(len(points))
    # All transmitters at once are 5 to 6 dB more.
    assert found[1] > 1.2 * found[0]


def test_errors_of_calibration_move_points():
    changes = LOW | {"terrain": {"kind": "flat", "size_m": [200.0, 200.0]}, "platform.length_m": 2.0}
    scatter = []
    for phase_deg in (0.0, 25.0):
        radar = LOW["radar"] | {"array": {"chirps": 16, "multiplexing": "bpm", "phase_error_deg": phase_deg}}
        points = run(load_scenario("hills", changes | {"radar": radar})).points
        scatter.append(np.median(np.abs(points.position_m[:, 2])))
    assert scatter[1] > 1.5 * scatter[0]


def test_the_same_errors_are_those_of_one_module():
    errors = {"phase_error_deg": 5.0, "gain_error_db": 1.0, "coupling_db": -25.0}
    prepared = [
        prepare(load_scenario("hills", LOW | {"radar": LOW["radar"] | {"array": errors}, "seed": seed}))
        for seed in (1, 1, 2)
    ]
    codes = [p.instrument.module.sent_code for p in prepared]
    assert np.array_equal(codes[0], codes[1])
    assert not np.array_equal(codes[0], codes[2])
    # What processing knows is what calibration left.
    assert prepared[0].angle.array.true_code is None
    assert prepared[0].angle.array.mixing is None


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"sensor": "radar"}, r"radar\.array: has no effect on sensor = 'radar'; set sensor = 'mimo'"),
        ({"radar": {"preset": "ti_awr1843"}}, r"radar\.array: missing; sensor = 'mimo' needs its elements"),
        (
            {"radar.scan": {"mode": "whisk_broom"}},
            r"scan\.mode: 'whisk_broom' is not supported with frames",
        ),
        ({"radar.array.frame_rate_hz": 500.0}, r"frame_rate_hz: 500 frames of 6 ms do not fit .* lower it to 167"),
        ({"radar.sweep": "triangular"}, r"radar\.sweep: 'triangular' is not supported with frames"),
        ({"tracing.speckle": "per_pulse"}, r"tracing\.speckle: 'per_pulse' is not supported with frames of an array"),
        (
            {"radar.receiver.high_pass_corner_hz": 1e4},
            r"radar\.receiver: is not supported with frames",
        ),
        (
            {"radar.array.receivers_wavelengths": [[0, 0], [0.5, 0], [0.5, 0.0]]},
            r"receivers_wavelengths: elements 1 and 2 are both at \[0\.5, 0\.0\]; move or remove one",
        ),
        ({"radar.array.transmitters_wavelengths": []}, r"transmitters_wavelengths: has 0 elements; give 1 to 64"),
    ],
)
def test_arrays_that_cannot_fly_are_refused(changes, said):
    with pytest.raises(ScenarioError, match=said):
        load_scenario("hills", LOW | changes)


def warned(speed_mps=5.0, falling="", **array):
    from sionna_radar.radar.build import build_array, build_chirp

    radar = RadarTable(preset="ti_awr1843_array", array=array)
    module = build_array(radar.array, build_chirp(radar), 1 / radar.chirp_rate_hz, 1)
    beam, velocity_mps = np.deg2rad([56.0, 28.0]), np.array([0.0, 0.0, speed_mps])
    return " ".join(array_warnings(module, np.deg2rad(50), tuple(beam), velocity_mps, 20.0, 0.375, falling))


def test_a_good_module_is_told_nothing():
    assert warned() == ""


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"receivers_wavelengths": [[0, 0], [1, 0]], "transmitters_wavelengths": [[0, 0]]},
            "repeats beams 90 deg apart",
        ),
        (
            {
                "receivers_wavelengths": [[0, 0], [0.5, 0]],
                "transmitters_wavelengths": [[0, 0], [0.5, 0], [1.0, 0.0], [1.5, 0.0]],
            },
            "3 places of",
        ),
        ({"speed_mps": 25.0}, "range rates fold at 5.19 m/s, where"),
        (
            {"receivers_wavelengths": [[0, 0], [0, 0.5]], "transmitters_wavelengths": [[0, 0], [0.5, 0]]},
            "the array extends 0.5 wavelengths across the motion",
        ),
        (
            {"receivers_wavelengths": [[0, 0], [0, 0.5], [0, 1.0]], "transmitters_wavelengths": [[0, 0]]},
            "the array extends 0 wavelengths across the motion",
        ),
        ({"falling": "rain"}, "rain fills all cells in front of the ground"),
        ({"chirps": 8, "speed_mps": 1.0}, "too few to sharpen"),
        ({"chirps": 1024, "speed_mps": 60.0}, "a frame of 192 ms is longer than the 166 ms"),
        ({"chirps": 512, "speed_mps": 20.0}, "ground moves by 0.464 m in range during a frame"),
    ],
)
def test_arrays_and_frames_that_lose_something_are_told(changes, said):
    assert said in warned(**changes)
