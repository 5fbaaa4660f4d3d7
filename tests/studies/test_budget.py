"""The budget of navigation: limits where closed forms know them, grades, and what the command leaves."""

import json
import math

import numpy as np
import pytest

from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.scenario import load_scenario, parse_scenario
from sionna_radar.studies.budget.document import DOCUMENT
from sionna_radar.studies.budget.study import (
    GRADES,
    NavigationError,
    find_limit,
    load_grades,
    navigation_errors,
    rms_with,
)
from sionna_radar.studies.budget.study import (
    navigation_budget as run_budget,
)
from sionna_radar.survey.observed_survey import observe_survey

SMALL = {
    "terrain": {"kind": "flat", "size_m": [340.0, 340.0]},
    "platform": {"altitude_m": 50.0, "speed_mps": 10.0, "length_m": 20.0},
    "radar": {"snr_db": 30.0},
    "tracing": {"paths_per_pulse": 64},
}
BY_NAME = {(error.name, error.kind): error for error in navigation_errors()}


@pytest.fixture(scope="module")
def survey():
    return observe_survey(parse_scenario(SMALL))


@pytest.fixture(scope="module")
def exact(survey):
    return survey.lit_error(None)


def test_every_error_is_a_key_of_a_scenario():
    for error in navigation_errors():
        table = error.table(0.01)
        assert table.has_errors
        assert getattr(table, error.key) != 0
    assert len(BY_NAME) == len(navigation_errors()) == 21


def test_a_vertical_bias_adds_to_the_square_of_the_rms(survey, exact):
    """The worse sign of a bias b makes (|mean| + b)^2 + std^2 of the mean square."""
    limit = find_limit(survey, BY_NAME["position, up", "constant"], exact.rms_m, 0.1, 1)
    expected = math.sqrt((1.1 * exact.rms_m) ** 2 - exact.std_m**2) - abs(exact.mean_m)
    assert limit == pytest.approx(expected, rel=0.03)


def test_a_pitch_limit_is_the_one_of_the_lever_it_works_on(survey, exact):
    """Pitch by e lifts every echo of level ground by about its distance ahead, 50 m and more, times e."""
    limit = find_limit(survey, BY_NAME["pitch", "constant"], exact.rms_m, 0.1, 1)
    up = find_limit(survey, BY_NAME["position, up", "constant"], exact.rms_m, 0.1, 1)
    assert 0.7 * up / 66 < math.radians(limit) < 1.1 * up / 50


def test_an_error_that_does_not_matter_has_no_limit(survey, exact):
    """On a plane a shift sideways changes no height."""
    sideways = NavigationError(
        name="east", kind="constant", unit="m", key="position_constant_m", axes=(1.0, 0.0, 0.0), first=0.5, largest=1.0
    )
    assert find_limit(survey, sideways, exact.rms_m, 0.1, 1) == math.inf
    assert rms_with(survey, sideways, 0.5, 1)[0] == pytest.approx(exact.rms_m, rel=0.1)


def test_the_limit_is_where_the_rms_has_grown_by_a_tenth(survey, exact):
    for key in (("position, up", "white"), ("roll", "markov")):
        limit = find_limit(survey, BY_NAME[key], exact.rms_m, 0.1, 2)
        assert rms_with(survey, BY_NAME[key], limit, 2)[0] == pytest.approx(1.1 * exact.rms_m, rel=0.004)


def test_the_budget_is_written_and_printed(tmp_path, capsys):
    errors = (BY_NAME["position, up", "constant"], BY_NAME["heading", "white"], BY_NAME["time offset", "constant"])
    calls = []
    budget = run_budget(
        parse_scenario(SMALL), repeat=1, errors=errors, execution=Execution(progress=lambda *step: calls.append(step))
    )
    rows = len(errors) + len(GRADES)
    assert calls[-1] == ("mapping", rows, rows)
    assert {stage for stage, _, _ in calls} == {"preparing", "tracing", "mapping"}
    assert len(repr(budget)) < 300
    assert [grade.name for grade in budget.grades] == list(GRADES)
    growth = {grade.name: grade.growth for grade in budget.grades}
    assert growth["survey"] < growth["rtk"] < growth["consumer"]
    files = DOCUMENT.write(budget, tmp_path / "out")
    assert {path.name for path in files} == {DOCUMENT.marker, "manifest.json", "budget.png"}
    told = json.loads((tmp_path / "out" / DOCUMENT.marker).read_text())
    assert told["limits"][0]["key"] == "platform.navigation.position_constant_m"
    assert told["limits"][0]["limit"] == pytest.approx(budget.limits[0].size)
    assert all(grade["source"] for grade in told["grades"])
    DOCUMENT.show(budget)
    printed = capsys.readouterr().out
    assert "position, up" in printed
    assert "survey" in printed


def test_grades_of_ones_own(tmp_path):
    path = tmp_path / "grades.toml"
    path.write_text('[mine]\nsource = "a datasheet"\nposition_white_m = 0.02\nattitude_markov_deg = [0.1, 0.1, 0.3]\n')
    mine = load_grades(path)["mine"]
    assert mine.source == "a datasheet"
    assert np.all(np.array(mine.errors.attitude_markov_deg) == [0.1, 0.1, 0.3])
    for text in ("[mine]\ngyro = 1\n", "mine = 3\n", "[mine\n"):
        path.write_text(text)
        with pytest.raises(InputFileError, match=r"grades\.toml"):
            load_grades(path)
    with pytest.raises(InputFileError):
        load_grades(tmp_path / "none.toml")


def test_a_limit_in_metres_is_a_growth(small):
    scenario = load_scenario(small)
    exact = run_budget(scenario, errors=(), grades={}).rms_m
    assert run_budget(scenario, errors=(), grades={}, limit_m=1.25 * exact).growth == pytest.approx(0.25)
    with pytest.raises(ScenarioError, match=r"--limit.*raise it"):
        run_budget(scenario, errors=(), grades={}, limit_m=0.9 * exact)


@pytest.mark.parametrize("repeat", [0, 1001, 10**309])
def test_more_draws_than_anyone_waits_for_are_refused(repeat):
    with pytest.raises(ScenarioError, match=r"--repeat: \d.* must be at least 1 and at most 1000"):
        run_budget(parse_scenario(SMALL), repeat=repeat)
