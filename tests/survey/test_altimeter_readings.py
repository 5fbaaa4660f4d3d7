"""A survey by a beam that does not scan reports its readings: table, summary, page and figure."""

import json

import numpy as np
import pytest

from sionna_radar import load_scenario, run
from sionna_radar.report.files.contents import Figures
from sionna_radar.report.survey.products import write_survey
from sionna_radar.report.survey.summary import survey_table
from sionna_radar.scenario.loading import parse_scenario, scenario_from

ALTIMETER = {
    "radar": {"preset": "alt_77000", "scan": {"mode": "fixed", "incidence_deg": 0.0}},
    "terrain.spacing_m": 2.0,
    "platform.altitude_m": 20.0,
    "platform.length_m": 40.0,
    "platform.height": "sensed",
    "tracing.speckle": "per_pulse",
    "tracing.paths_per_pulse": 256,
    "processing.ranging": "tracker",
    "processing.ranging_parameters": {"time_constant_s": 0.1},
    "processing.average": {"chirps": 25, "mode": "incoherent"},
    "processing.cfar.kind": "CA",
    "processing.volume_clutter": "off",
    "processing.min_range_m": 1.4,
}
TOP_M = 4.0


@pytest.fixture(scope="module")
def flown():
    roof = {"position_m": [-72.0, 0.0], "size_m": [8.0, 30.0, TOP_M], "material": "ground"}
    terrain = {"kind": "flat", "size_m": [340.0, 340.0]}
    own = {key: value for key, value in ALTIMETER.items() if not key.startswith("terrain.")}
    return run(load_scenario("hills", own | {"terrain": terrain, "buildings": [roof]}))


def test_an_altimeter_reads_the_ground_and_the_roof(flown):
    """Level soil 20 m below is read a little too near, as `docs/checks/radar_altimeters.md` has it; clearance."""
    readings = flown.readings
    assert readings.along == "vertical"
    before = readings.time_s < np.quantile(readings.time_s, 0.2)
    assert np.median((readings.reading_m - readings.true_m)[before]) == pytest.approx(-0.06, abs=0.06)
    assert readings.errors.drop_outs == 0
    assert readings.errors.lowest_clearance_m == pytest.approx(20.0 - TOP_M, abs=0.1)
    # Steered by them it climbs before the roof, which the true ground does not know.
    assert 16.2 < readings.by_readings_m < 20.0


def test_readings_are_in_table_summary_page_and_figures(flown, tmp_path):
    files = write_survey(flown, tmp_path / "results", figures=Figures.PNG)
    assert "figures/readings.png" in {file.relative_to(tmp_path / "results").as_posix() for file in files}
    summary = json.loads((tmp_path / "results" / "summary.json").read_text())
    assert summary["readings"]["errors"]["bias_m"] == pytest.approx(flown.readings.errors.bias_m)
    assert "readings" in summary["meaning"]
    page = (tmp_path / "results" / "report.html").read_text()
    assert "reading less height above ground" in page
    assert 'id="errors"' not in page
    names = list(survey_table(flown).columns[0].cells)
    assert {"reading less height above ground", "drop-outs", "latency", "lowest clearance flown"} <= set(names)


def test_a_beam_that_looks_ahead_reads_the_distance_along_its_axis():
    over = {"radar.scan": {"mode": "fixed", "incidence_deg": 45.0}, "platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    readings = run(load_scenario("hills", over)).readings
    assert readings.along == "axis"
    assert np.median(readings.true_m) > 60.0
    assert abs(readings.errors.bias_m) < 0.3
    assert readings.by_readings_m is None


def test_a_beam_that_looks_to_the_side_reads_distances_and_makes_no_map():
    """Between echoes whose ranges scatter a surface would follow the beam: 45 deg steep over ground of 10."""
    over = {
        "radar.scan": {"mode": "side_looking", "incidence_deg": 45.0},
        "radar.bandwidth_hz": 100e6,
        "radar.samples_per_chirp": 128,
        "radar.antenna.beamwidth_deg": 4.0,
        "platform.length_m": 10.0,
        "terrain.spacing_m": 2.0,
    }
    for method in ("linear", "smooth"):
        survey = run(load_scenario("hills", over | {"dem.method": method}))
        assert not survey.dem.filled.any()
        assert survey.readings.along == "axis"
        assert abs(survey.readings.errors.bias_m) < 0.3
        assert any("no map can be made" in warning for warning in survey.warnings)


def test_a_beam_that_scans_too_slowly_for_its_flight_is_not_said_to_be_still():
    slow = {"radar.scan.rotation_rpm": 3.0, "platform.length_m": 4.0, "terrain.spacing_m": 2.0}
    (warning,) = run(load_scenario("hills", slow)).warnings
    assert "of which no map can be made; scan across it" in warning
    assert "within the flight" in warning


def test_a_survey_that_makes_a_map_has_no_readings():
    survey = run(load_scenario("hills", {"platform.length_m": 6.0, "terrain.spacing_m": 2.0}))
    assert survey.readings is None


@pytest.mark.parametrize("method", ["stepped", "linear"])
def test_a_narrow_beam_over_a_roof_reads_whatever_method_maps_its_strip(method):
    """The stepped map fills cells along the line, which make no map."""
    radar = {"radar.scan": {"mode": "fixed", "incidence_deg": 0.0}, "radar.antenna.beamwidth_deg": 6.0}
    roof = {"position_m": [0.0, 0.0], "size_m": [8.0, 30.0, TOP_M], "heading_deg": 90.0}
    flight = {"platform.altitude_m": 20.0, "platform.length_m": 24.0, "platform.start_m": [-12.0, 0.0]}
    drawn = {"tracing.speckle": "per_pulse", "tracing.paths_per_pulse": 128, "dem.method": method}
    survey = run(load_scenario("buildings", radar | flight | drawn | {"buildings": [roof]}))
    assert any("of which no map can be made" in warning for warning in survey.warnings)
    assert (survey.lit_error.count > 0) == (method == "stepped")
    over = survey.readings.by_cover
    assert over["ground"].bias_m == pytest.approx(0.0, abs=0.6)
    assert over["building"].bias_m == pytest.approx(-TOP_M, abs=0.3)


@pytest.mark.parametrize(("preset", "altitude_m"), [("alt_24000", 210.0), ("alt_77000", 35.0)])
def test_a_scenario_to_start_from_reads_level_ground_as_the_altimeter_is_said_to(preset, altitude_m, tmp_path):
    """40 readings a second, from 25 sweeps each, without drop-outs; from single sweeps four of ten had no echo."""
    tables = scenario_from([preset], tmp_path)
    tables["platform"] |= {"altitude_m": altitude_m, "length_m": 6.0}
    readings = run(parse_scenario(tables | {"tracing": {"paths_per_pulse": 256, "speckle": "per_pulse"}})).readings
    assert np.allclose(np.diff(readings.time_s), 1 / 40)
    assert readings.errors.drop_outs == 0
    # +-0.7 m by the manual at 24 GHz; the smoothed readings of cells of 0.6 and 0.15 m scatter by a fraction of one.
    assert abs(readings.errors.bias_m) < 0.7
    assert readings.errors.std_m < 0.15


@pytest.mark.parametrize(("preset", "altitude_m"), [("alt_24000", 1.0), ("alt_77000", 0.4), ("alt_77000", 2.2)])
def test_ground_nearer_than_the_least_range_is_not_read_at_it(preset, altitude_m, tmp_path):
    """Its echo reaches into the searched ranges, and beyond zero into the last of I/Q samples."""
    tables = scenario_from([preset], tmp_path)
    tables["platform"] |= {"altitude_m": altitude_m, "length_m": 4.0, "height": "level"}
    survey = run(parse_scenario(tables | {"tracing": {"paths_per_pulse": 256, "speckle": "per_pulse"}}))
    assert survey.readings.errors.drop_outs == survey.readings.errors.pulses
    assert any("100% of the beams meet the ground nearer than" in warning for warning in survey.warnings)
