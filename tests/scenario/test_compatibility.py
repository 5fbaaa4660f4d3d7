"""Rows of settings that exclude each other: each is found in a scenario that has both, and is on the reference page."""

import pytest

from sionna_radar import ScenarioError, parse_scenario
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.compatibility import EXCLUSIONS, excluded_with, exclusions
from sionna_radar.scenario.reference import dotted_keys, reference, scenario_schema


@pytest.fixture(scope="module")
def keys():
    """All keys of scenarios, and two tables that rows name as a whole."""
    return {*dotted_keys(), "weather", "radar.receiver"}


@pytest.mark.parametrize("row", EXCLUSIONS, ids=lambda row: f"{row.setting.key} with {row.other.key}")
def test_keys_of_rows_are_keys_of_scenarios(row, keys):
    assert {row.setting.key, row.other.key} <= keys
    assert row.remedy
    assert not row.remedy.endswith(".")


def test_no_row_stands_twice():
    pairs = [frozenset((row.setting.words, row.other.words)) for row in EXCLUSIONS]
    assert len(pairs) == len(set(pairs))


def test_shipped_scenarios_contradict_no_row():
    for name in ("hills", "buildings", "rain", "two_fields", "slar"):
        assert list(exclusions(load_scenario(name))) == []


def test_the_message_names_value_other_setting_reason_and_remedy():
    base = load_scenario("hills").model_dump(mode="json", exclude_none=True)
    base["radar"]["sweep"], base["processing"]["echoes"] = "triangular", "all"
    message = (
        "processing.echoes: 'all' is not supported with pairs of sweeps, whose echoes cannot be paired; "
        "give 'strongest' or 'first'"
    )
    with pytest.raises(ScenarioError, match=message):
        parse_scenario(base)


def test_each_of_two_keys_knows_the_other():
    assert "pairs of sweeps" in set(excluded_with("processing.echoes"))
    assert "all echoes of a pulse" in set(excluded_with("radar.sweep"))


def test_the_schema_and_the_reference_say_what_a_key_is_not_supported_with():
    said = scenario_schema()["$defs"]["RadarTable"]["properties"]["sweep"]["description"]
    assert said.endswith(" averaged chirps, refined navigation.")
    assert "Not with all echoes of a pulse, maps of whole echoes, several receivers, frames of an array" in said
    page = reference()
    for row in EXCLUSIONS:
        assert any(
            row.other.words in line for line in page.splitlines() if f"`{row.setting.key.split('.')[-1]}`" in line
        )
