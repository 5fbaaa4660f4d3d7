"""Fixed beams, whose echoes lie on a line."""

import pytest

from sionna_radar import load_scenario, run

FIXED = {"radar.scan": {"mode": "fixed"}, "platform.heading_deg": 30.0, "platform.length_m": 10.0}


@pytest.mark.parametrize("method", ["smooth", "refined", "stepped"])
def test_a_boresight_that_is_a_little_off_maps_a_line_as_well_as_one_that_is_not(method):
    """Its echoes lie off their line by micrometres, over which a plane must not be tilted."""
    off = {"platform.navigation.boresight_error_deg": 0.05}
    dem_error = run(load_scenario("hills", {**FIXED, **off, "dem.method": method})).dem_error
    assert dem_error.count > 0
    assert dem_error.rms_m < 0.5
