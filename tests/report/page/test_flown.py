"""What a page says of a flight."""

import pytest

from sionna_radar import load_scenario
from sionna_radar.report.page.scene_data import flown_rows
from sionna_radar.survey.preparation import prepare


@pytest.mark.parametrize(
    ("keys", "rate"), [({"radar.stagger": 0.5}, "288 Hz"), ({"processing.average.chirps": 4}, "90 Hz")]
)
def test_the_pulse_rate_is_that_of_pulses(keys, rate):
    scenario = load_scenario("hills", {"platform.length_m": 10.0, "terrain.spacing_m": 2.0, **keys})
    assert flown_rows(prepare(scenario))["Pulse rate"] == rate
