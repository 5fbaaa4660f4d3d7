"""Smooth maps of sensors that bring points alone: a lidar, and a radar with a triangular sweep."""

import numpy as np
import pytest

from sionna_radar.scenario import parse_scenario
from sionna_radar.survey.chain import run

HILLS = {
    "seed": 4,
    "terrain": {"kind": "hills", "size_m": [300.0, 300.0], "spacing_m": 2.0, "seed": 2},
    "platform": {"altitude_m": 50.0, "speed_mps": 10.0, "length_m": 15.0},
    "radar": {"snr_db": 30.0},
    "tracing": {"paths_per_pulse": 64},
}
LIDAR = {"sensor": "lidar", "lidar": {"range_noise_m": 0.3}}
TRIANGLE = {"radar": {"snr_db": 30.0, "sweep": "triangular"}}


@pytest.mark.parametrize("sensor", [LIDAR, TRIANGLE], ids=["lidar", "triangular sweep"])
def test_points_alone_make_a_smooth_map(sensor):
    """Heights between noisy points agree with each other: the smooth map errs less than the linear one."""
    linear, smooth = (run(parse_scenario(HILLS | sensor | {"dem": {"method": m}})) for m in ("linear", "smooth"))
    assert smooth.points.sha256() == linear.points.sha256()
    assert np.isfinite(smooth.lit_error.rms_m)
    assert smooth.lit_error.coverage > 0.9 * linear.lit_error.coverage > 0.65
    assert smooth.lit_error.rms_m < 0.9 * linear.lit_error.rms_m
    assert abs(smooth.lit_error.mean_m) < 0.2
    assert np.isnan(smooth.dem.height_m).any(), "what no beam reached stays empty"
