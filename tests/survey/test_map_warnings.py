"""A map that is none is said to be none, with the cause and the remedy; and presets fly a scan that maps."""

import json
import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh

from elevation_files import from_origin, write_heights
from sionna_radar import load_scenario, prepare, run
from sionna_radar.report.survey.products import write_survey
from sionna_radar.scenario.presets import PRESETS
from sionna_radar.survey.warnings import map_warnings

# Warnings are looked at, in files and pages too, but no figures.
pytestmark = pytest.mark.usefixtures("rough_errors", "undrawn")

SHORT = {"platform.length_m": 20.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64}
# The narrow beams of some modules need millions of scatterers that stay, whose echoes lie where those of others do.
DRAWN = {"tracing.speckle": "per_pulse", "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64}


def warned(over: dict, scene: str = "hills") -> tuple[str, ...]:
    return run(load_scenario(scene, SHORT | over)).warnings


def has(warnings: tuple[str, ...], *words: str) -> bool:
    return any(all(word in warning for word in words) for warning in warnings)


def test_a_beam_that_draws_a_line_makes_no_map():
    for heading_deg in (0.0, 77.0):
        warnings = warned({"radar.scan": {"mode": "fixed"}, "platform.heading_deg": heading_deg})
        assert has(warnings, "strip 0.0 m wide", "radar.scan.mode = 'whisk_broom'")
        assert len(warnings) == 1


def test_a_lone_echo_is_told_as_silence_and_not_as_a_line():
    points = run(load_scenario("hills", SHORT)).points.rows(np.arange(1))
    for pulses, start in ((300, "299 of 300 pulses (100%) have no echo"), (1, "all echoes lie on a strip")):
        (only,) = map_warnings(points, pulses, filled=0, coverage=0.0, spacing_m=1.0, louder="radar.snr_db")
        assert only.startswith(start)


def test_echoes_without_a_direction_ask_for_another_receiver():
    points = run(load_scenario("hills", SHORT)).points.rows(np.arange(1))
    (only,) = map_warnings(points, 300, filled=0, coverage=0.0, spacing_m=1.0, louder="radar.snr_db", directed=True)
    assert only.endswith("have no direction of arrival; change radar.second_receiver, or raise radar.snr_db")


def test_pulses_without_echoes_and_cells_without_heights_are_told():
    faint = warned({"radar.snr_db": -15.0, "terrain.spacing_m": 1.0})
    assert has(faint, "pulses", "have no echo; raise radar.snr_db")
    assert has(faint, "no cell that the beam reached is filled")
    sparse = warned({"radar.scan.rotation_rpm": 60.0, "platform.speed_mps": 20.0, "dem.max_gap_m": 0.5})
    assert has(sparse, "filled: echoes lie farther apart than dem.max_gap_m")
    assert not has(sparse, "have no echo")


@pytest.mark.parametrize(
    ("level_db", "more", "told"),
    [
        (-40.0, {}, True),
        (-40.0, {"processing.leakage": "subtract"}, False),
        (-40.0, {"processing.min_range_m": 25.0}, False),
        (-100.0, {}, False),
        (-40.0, {"radar.sweep": "triangular", "radar.sampling": "iq"}, True),
    ],
)
def test_echoes_that_are_leakage_are_told(level_db, more, told):
    leaky = {"radar.snr_db": None, "radar.transmit_power_dbm": 12.0, "radar.noise_figure_db": 15.0}
    leaky |= {"radar.receiver.leakage": [{"delay_ns": 15.0, "level_db": level_db}], "platform.length_m": 4.0}
    assert has(warned(leaky | more), "radar.receiver.leakage has at least half of their power") == told


def test_a_map_that_is_one_is_told_nothing():
    assert warned({}) == ()


# An altimeter looks down and makes a profile, no map.
ALTIMETERS = ("alt_4300", "alt_24000", "alt_77000")


# Modules with arrays map without a scan, see `test_mimo`; panoramic radars map no heights, see `test_panorama`.
SCANNING = [
    name
    for name, preset in PRESETS.items()
    if name not in ALTIMETERS and "array" not in preset.keys and preset.keys["scan"]["mode"] != "panoramic"
]


@pytest.mark.parametrize("preset", SCANNING)
def test_presets_fly_a_scan_that_maps(preset):
    assert PRESETS[preset].keys["scan"]["mode"] != "fixed"
    # Low enough to be heard, and high enough for the Doppler shift of AVTIS2, 33 m at 10 m/s.
    altitude_m = 50.0 if preset == "avtis2" else 15.0
    over = {"radar": {"preset": preset}, "platform.altitude_m": altitude_m, "platform.length_m": 30.0}
    survey = run(load_scenario("hills", DRAWN | over))
    assert survey.warnings == ()
    assert survey.lit_error.coverage > 0.5


@pytest.mark.parametrize("preset", ALTIMETERS)
def test_an_altimeter_says_that_its_profile_is_no_map(preset):
    survey = run(load_scenario("hills", DRAWN | {"radar": {"preset": preset}, "platform.length_m": 10.0}))
    assert has(survey.warnings, "all echoes lie on a strip")


@pytest.fixture
def low() -> dict:
    """AVTIS2 at 10 m/s: 33 m of Doppler shift take ground 22 m away below zero, where it folds to 44 m."""
    return DRAWN | {"radar": {"preset": "avtis2"}, "platform.altitude_m": 15.0, "platform.length_m": 30.0}


def test_echoes_that_doppler_folds_are_told(low, tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        survey = run(load_scenario("hills", low))
    assert survey.dem_error.mean_m < -10.0
    (warning,) = (w for w in survey.warnings if "Doppler" in w)
    assert warning.startswith("in 100% of the pulses")
    assert warning in caplog.messages
    write_survey(survey, tmp_path / "out")
    assert warning in json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"]
    assert "in 100% of the pulses Doppler" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    "remedy",
    [
        {"radar.chirp_rate_hz": 187.0},
        {"platform.speed_mps": 5.0},
        {"platform.altitude_m": 40.0},
        {"radar.sweep": "down"},
    ],
    ids=str,
)
def test_echoes_that_doppler_leaves_in_the_searched_ranges_are_right_and_told_nothing(low, remedy):
    survey = run(load_scenario("hills", low | remedy))
    assert not has(survey.warnings, "Doppler")
    assert not has(survey.warnings, "in front of it")  # the shifted ground of clear air is no rain
    assert abs(survey.dem_error.mean_m) < 0.3


def test_the_chirp_rate_of_the_warning_is_the_least_that_helps(low):
    def told(rate_hz: float) -> list[str]:
        warnings = prepare(load_scenario("hills", low | {"radar.chirp_rate_hz": rate_hz})).warnings
        return [warning for warning in warnings if "Doppler" in warning]

    needed_hz = float(told(100.0)[0].split("chirp_rate_hz to ")[1].split(",")[0])
    assert told(0.9 * needed_hz)
    assert not told(1.05 * needed_hz)


@pytest.mark.parametrize("sweep", ["down", "triangular"])
def test_ground_near_the_greatest_range_is_told_of_where_the_shift_adds(sweep):
    over = {"radar.sweep": sweep, "radar.samples_per_chirp": 747, "platform.speed_mps": 10.0, "radar.chirp_rate_hz": 45}
    warnings = prepare(load_scenario("hills", SHORT | over)).warnings
    assert has(warnings, "Doppler", "fly lower or slower")


def grid_file(path: Path, posting_m: float) -> Path:
    count = round(600 / posting_m) + 1
    height_m = 3 * np.sin(np.arange(count) * posting_m / 40)[None] * np.ones((count, 1))
    corner = from_origin(690_000 - posting_m / 2, 5_330_600 + posting_m / 2, posting_m, posting_m)
    return write_heights(path, height_m.astype("float32"), corner)


def test_ground_without_detail_below_the_footprint_is_told(tmp_path):
    """The error is that against interpolated heights: 30 m apart, they look easier than 1 m apart."""
    coarse, fine = (grid_file(tmp_path / f"{posting:g}.tif", posting) for posting in (30.0, 1.0))
    said = [
        warned({"terrain": {"kind": "raster", "path": str(path), **more}})
        for path, more in ((coarse, {}), (coarse, {"spacing_m": 1.0}), (fine, {}), (fine, {"spacing_m": 10.0}))
    ]
    told = [has(warnings, "are 30 m apart", "footprints 2", "terrain.roughen") for warnings in said[:2]]
    assert told == [True, True]
    assert said[2] == ()
    assert has(said[3], "are 10 m apart")
    rough = warned({"terrain": {"kind": "raster", "path": str(coarse), "roughen": {"rms_m": 0.1}}})
    assert has(rough, "seeded detail of 0.1 m RMS")
    assert not has(rough, "apart, footprints")


def test_what_the_console_says_is_in_the_result(tmp_path, caplog):
    """Repaired meshes, in the first survey and in the next ones, which take the scene from it."""
    box = trimesh.creation.box((4.0, 4.0, 3.0))
    torn = trimesh.Trimesh(box.vertices, np.vstack([box.faces, [0, 0, 1]]), process=False)
    torn.export(tmp_path / "torn.ply")
    objects = [{"path": str(tmp_path / "torn.ply"), "position_m": [0.0, 0.0], "material": "building"}]
    for number in range(2):
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            survey = run(load_scenario("hills", SHORT | {"objects": objects}))
        assert has(survey.warnings, "repaired")
        assert [r.getMessage() for r in caplog.records if r.name == "sionna_radar"] == list(survey.warnings)
        write_survey(survey, tmp_path / f"out{number}")
        assert json.loads((tmp_path / f"out{number}" / "summary.json").read_text())["warnings"] == list(survey.warnings)
        assert "repaired" in (tmp_path / f"out{number}" / "report.html").read_text()


def test_beams_beyond_the_unambiguous_range_are_told_and_their_echoes_left_out():
    """Over mountains the farthest ground lies up to 400 m away, of 256 m that the samples reach."""
    flight = {
        "platform.altitude_m": 25.0,
        "platform.speed_mps": 3.0,
        "platform.length_m": 10.0,
        "radar.bandwidth_hz": 300e6,
        "radar.samples_per_chirp": 1024,
        "radar.chirp_rate_hz": 347.0,
        "radar.antenna.beamwidth_deg": 1.5,
        "radar.scan": {"mode": "conical", "incidence_deg": 70.0, "half_swath_deg": 40.0},
        "tracing.paths_per_pulse": 96,
        "dem.method": "linear",
    }
    survey = run(load_scenario("jacksboro", flight))
    assert has(survey.warnings, "beyond the 255.8 m of unambiguous range, up to")
    assert survey.lit_error.le95_m < 0.6


def test_ranges_that_keep_their_doppler_shift_are_told():
    """At 10 m/s, 45 deg ahead, up-sweeps of 2.8 ms show still ground some 3 m off; corrected or paired ones do not."""
    off = {"processing.doppler_correction": False}
    assert has(warned(off), "keep the Doppler shift of the radar's own motion", "processing.doppler_correction = true")
    assert not has(warned({}), "Doppler")
    assert not has(warned(off | {"radar.sweep": "triangular"}), "Doppler")
