"""Which DEM method a scenario gets that names none."""

import pytest

from sionna_radar.scenario.loading import load_scenario

# Lines are 5 m apart at 120 rpm; on level ground 50 m below, at 45 deg, a beam of 2 deg is 3.5 m long.
FOOTPRINT_M = 3.49


@pytest.mark.parametrize(
    ("overrides", "method"),
    [
        ({}, "stepped"),
        ({"radar.scan.rotation_rpm": 600 / (1.98 * FOOTPRINT_M)}, "stepped"),
        ({"radar.scan.rotation_rpm": 600 / (2.02 * FOOTPRINT_M)}, "linear"),
        ({"platform.speed_mps": 20.0}, "linear"),
        ({"platform.speed_mps": 20.0, "platform.altitude_m": 100.0}, "stepped"),
        ({"radar.antenna.beamwidth_deg": [2.0, 1.0]}, "linear"),
        ({"radar.antenna.beamwidth_deg": [1.0, 2.0]}, "stepped"),
        ({"radar.scan.mode": "conical", "radar.scan.rotation_rpm": 60.0}, "stepped"),
        ({"dem.method": "stepped", "platform.speed_mps": 20.0}, "stepped"),
        ({"weather.rain_rate_mm_per_h": 5.0}, "linear"),
    ],
)
def test_buildings_are_mapped_with_steps_where_lines_are_dense(overrides, method):
    scenario = load_scenario("buildings", overrides)
    assert scenario.dem.method == method
    assert scenario.processing.echoes == ("all" if method == "stepped" else "strongest")


def test_hills_are_mapped_without_steps():
    assert load_scenario("hills").dem.method == "linear"
