"""A prepared survey flies as its scenario does, and custom parts that lack something are refused by name."""

from dataclasses import fields

import numpy as np
import pytest

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import load_scenario, parse_scenario
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.result import Survey
from surveys import hills

HILLS = hills(terrain__size_m=[300.0, 300.0], platform__length_m=10.0, tracing__paths_per_pulse=64)
MEASURED = ("paths", "lit", "dem_error", "lit_error")


def assert_same(survey: Survey, other: Survey) -> None:
    assert survey.points.sha256() == other.points.sha256()
    for raster in ("dem", "truth", "error"):
        np.testing.assert_array_equal(getattr(survey, raster).height_m, getattr(other, raster).height_m, err_msg=raster)
    for name in MEASURED:
        np.testing.assert_array_equal(getattr(survey, name), getattr(other, name), err_msg=name)
    for field in fields(survey.chirp):
        np.testing.assert_array_equal(
            getattr(survey.chirp, field.name), getattr(other.chirp, field.name), err_msg=field.name
        )


def test_a_prepared_survey_flies_as_its_scenario_does_and_as_often_as_wanted():
    flown, prepared = run(HILLS), prepare(HILLS)
    for _ in range(2):
        survey = run(prepared)
        assert survey.prepared is prepared
        assert_same(survey, flown)


def test_the_file_s_name_leads_what_is_said_of_its_flight(tmp_path):
    path = tmp_path / "low.toml"
    path.write_text(
        '[terrain]\nkind = "flat"\n[platform]\naltitude_m = 1000.0\nspeed_mps = 5.0\n[radar]\nsnr_db = 30.0\n',
        encoding="utf-8",
    )
    scenario = load_scenario(path)
    for refused in (scenario, scenario.replace({"seed": 2})):
        with pytest.raises(ScenarioError) as caught:
            prepare(refused)
        assert str(caught.value).startswith(f"{path}: 1 problem\n")
    with pytest.raises(ScenarioError, match=r"^scenario: 1 problem"):
        prepare(parse_scenario(scenario.model_dump(exclude_none=True)))
    assert scenario == parse_scenario(scenario.model_dump(exclude_none=True))
