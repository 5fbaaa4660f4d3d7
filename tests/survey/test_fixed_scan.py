"""Fixed beams, whose echoes lie on a line."""

import pytest

from sionna_radar import load_scenario, run

FIXED = {"radar.scan": {"mode": "fixed"}, "platform.heading_deg": 30.0, "platform.length_m": 10.0}


@pytest.mark.parametrize("method", ["linear", "smooth", "refined", "stepped"])
def test_a_boresight_that_is_a_little_off_draws_a_line_as_well_as_one_that_is_not(method):
    """Its echoes lie off their line by micrometres: by any method they make readings and no map."""
    off = {"platform.navigation.boresight_error_deg": 0.05}
    survey = run(load_scenario("hills", {**FIXED, **off, "dem.method": method}))
    assert not survey.dem.filled.any()
    assert survey.readings.errors.drop_outs == 0
    assert abs(survey.readings.errors.bias_m) < 0.5
