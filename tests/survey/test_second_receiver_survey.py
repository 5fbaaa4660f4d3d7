"""Surveys with a receiver beside the first, and those without one as they were."""

import numpy as np
import pytest

from sionna_radar import load_scenario, process, run
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.studies.twin.study import twin as run_twin
from sionna_radar.survey.observation import Observed, observe
from sionna_radar.survey.preparation import prepare

SHORT = {
    "platform.length_m": 15.0,
    "terrain.spacing_m": 2.0,
    "tracing.paths_per_pulse": 192,
    "radar.antenna.beamwidth_deg": 8.0,
}
ON = SHORT | {"processing.angle": "interferometric", "radar.second_receiver.axis": "both"}


@pytest.fixture(scope="module")
def surveys():
    return {name: run(load_scenario("hills", changes)) for name, changes in (("off", SHORT), ("on", ON))}


def test_directions_bring_a_wide_beam_to_the_ground(surveys):
    assert surveys["on"].lit_error.rms_m < 0.4 * surveys["off"].lit_error.rms_m
    assert surveys["on"].lit_error.coverage > surveys["off"].lit_error.coverage
    assert len(surveys["on"].points) > 2 * len(surveys["off"].points)
    assert surveys["on"].points.across_sigma_m.shape == surveys["on"].points.range_m.shape
    assert surveys["off"].points.across_sigma_m is None


def test_a_receiver_that_is_not_used_changes_no_bit(surveys):
    idle = run(load_scenario("hills", SHORT | {"radar.second_receiver.axis": "both"}))
    assert idle.points.sha256() == surveys["off"].points.sha256()
    np.testing.assert_array_equal(idle.dem.height_m, surveys["off"].dem.height_m)
    said = "radar.second_receiver is not used; set processing.angle = 'interferometric', or remove it"
    assert said in idle.warnings
    assert said not in surveys["on"].warnings + surveys["off"].warnings


def test_neither_the_block_size_nor_packing_changes_a_bit(surveys):
    prepared = prepare(load_scenario("hills", ON))
    recording = observe(prepared, Execution(block_size=37))[1]
    again = Observed.unpacked(recording.packed())
    for found in (recording, again):
        np.testing.assert_array_equal(found.echoes.direction, recording.echoes.direction)
        np.testing.assert_array_equal(found.echoes.across_sigma_rad, recording.echoes.across_sigma_rad)
    assert run(prepared, execution=Execution(block_size=37)).points.sha256() == surveys["on"].points.sha256()


def test_a_phase_error_tilts_the_points():
    """Half a radian between the receivers of an elevation pair lifts or lowers what lies ahead."""
    wrong = run(load_scenario("hills", ON | {"platform.length_m": 8.0, "radar.second_receiver.phase_error_deg": 20.0}))
    assert abs(wrong.lit_error.mean_m) > 1.0


def test_one_axis_is_warned_of_where_it_does_not_tell_height():
    """A whisk-broom turns the range cells across the beam, a conical scan keeps them across the elevation axis."""
    told, shorter = {}, ON | {"platform.length_m": 8.0}
    for name, changes in (("whisk", {}), ("cone", {"radar.scan.mode": "conical"})):
        for axis in ("elevation", "azimuth"):
            survey = run(load_scenario("hills", shorter | changes | {"radar.second_receiver.axis": axis}))
            told[name, axis] = " ".join(survey.warnings)
            if (name, axis) == ("cone", "elevation"):
                assert survey.lit_error.rms_m < 0.15
    assert "set radar.second_receiver.axis = 'both'" in told["whisk", "elevation"]
    assert told["cone", "elevation"] == ""
    assert "no direction was found for any echo" in told["cone", "azimuth"]
    assert "no echo" not in told["cone", "azimuth"]


@pytest.mark.parametrize(
    ("angle", "receiver"),
    [
        ("interferometric", {"axis": "both", "phase_error_deg": 3.0}),
        ("monopulse", {"kind": "monopulse"}),
        ("row", {"kind": "row", "axis": "elevation", "receivers": 5}),
    ],
)
def test_recorded_signals_of_all_receivers_make_the_same_points_and_map(angle, receiver, tmp_path):
    keys = SHORT | {"platform.length_m": 4.0, "processing.angle": angle, "radar.second_receiver": receiver}
    survey = run(load_scenario("hills", keys), recordings={"signals": tmp_path / "all.nc"})
    again = process(tmp_path / "all.nc")
    assert again.points.sha256() == survey.points.sha256()
    np.testing.assert_array_equal(again.dem.height_m, survey.dem.height_m)
    with pytest.raises(InputFileError, match="holds signals of an array"):
        run_twin(tmp_path / "all.nc")
    # Without the others the first receiver is one of its own.
    alone = process(tmp_path / "all.nc", {"processing.angle": "off"})
    flown = run(load_scenario("hills", keys | {"processing.angle": "off"}))
    assert alone.points.sha256() == flown.points.sha256()


def test_signals_of_one_receiver_are_not_made_into_directions(tmp_path):
    run(
        load_scenario("hills", SHORT | {"radar.second_receiver.axis": "both"}),
        recordings={"signals": tmp_path / "one.nc"},
    )
    with pytest.raises(ScenarioError, match="needs all receivers, which the recording does not have"):
        process(tmp_path / "one.nc", {"processing.angle": "interferometric"})


@pytest.mark.parametrize("terrain", ["hills", "ridges"])
def test_a_long_row_finds_the_mean_of_one_surface_as_a_pair_does(terrain):
    """Where MUSIC's direction and a lobe of the whole row hear other speckle than the range does."""
    narrow = {"platform.length_m": 50.0, "radar.antenna.beamwidth_deg": 4.0, "radar.scan.mode": "conical", "seed": 5}
    row = {"processing.angle": "row", "radar.second_receiver.kind": "row", "radar.second_receiver.receivers": 8}
    survey = run(load_scenario(terrain, narrow | row | {"radar.second_receiver.axis": "both"}))
    assert survey.lit_error.rms_m < 0.032
    assert survey.dem_uncertainty.cells.coverage["95"] > 0.92


def test_a_map_of_a_wide_beam_knows_the_curvature_in_its_strips():
    """Strips twice as long as wide: a round footprint of their area held 86 % of the heights in 95 % intervals."""
    wide = {"platform.length_m": 50.0, "radar.antenna.beamwidth_deg": 8.0, "radar.scan.mode": "conical", "seed": 5}
    row = {"processing.angle": "row", "radar.second_receiver.kind": "row", "radar.second_receiver.receivers": 4}
    survey = run(load_scenario("ridges", wide | row | {"radar.second_receiver.axis": "both", "terrain.seed": 5}))
    assert survey.dem_uncertainty.cells.coverage["95"] > 0.9
