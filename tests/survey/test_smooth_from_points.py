"""Smooth maps of sensors that bring points alone: a lidar, and a radar with a triangular sweep."""

import numpy as np
import pytest

from sionna_radar.survey.chain import run
from surveys import hills

KEYS = {"terrain.size_m": [300.0, 300.0], "platform.length_m": 15.0, "tracing.paths_per_pulse": 64}
LIDAR = {"sensor": "lidar", "lidar.range_noise_m": 0.3}
TRIANGLE = {"radar.sweep": "triangular"}


@pytest.mark.parametrize("sensor", [LIDAR, TRIANGLE], ids=["lidar", "triangular sweep"])
def test_points_alone_make_a_smooth_map(sensor):
    """Heights between noisy points agree with each other: the smooth map errs less than the linear one."""
    linear, smooth = (run(hills(**KEYS, **sensor, dem__method=m)) for m in ("linear", "smooth"))
    assert smooth.points.sha256() == linear.points.sha256()
    assert np.isfinite(smooth.lit_error.rms_m)
    assert smooth.lit_error.coverage > 0.9 * linear.lit_error.coverage > 0.65
    assert smooth.lit_error.rms_m < 0.9 * linear.lit_error.rms_m
    assert abs(smooth.lit_error.mean_m) < 0.2
    assert np.isnan(smooth.dem.height_m).any(), "what no beam reached stays empty"
