"""Denormal numbers are zero while the ray tracer works in a thread of Python, and only then."""

import threading

import numpy as np
import pytest

from sionna_radar.raytracer.backend import can_flush, flushed_denormals

pytestmark = pytest.mark.skipif(not can_flush(), reason="this machine's threads are left as they are")


def product() -> float:
    """A hundredth of the least normal number of single precision."""
    return float((np.full(8, 1e-20, dtype=np.float32) * np.full(8, 1e-20, dtype=np.float32))[0])


def test_they_are_zero_inside_and_themselves_outside():
    assert product() == pytest.approx(1e-40, rel=1e-4)
    with flushed_denormals():
        assert product() == 0
        with flushed_denormals():
            assert product() == 0
        assert product() == 0
    assert product() == pytest.approx(1e-40, rel=1e-4)


def test_an_error_inside_leaves_them_themselves():
    with pytest.raises(ValueError, match="inside"), flushed_denormals():
        raise ValueError("inside")
    assert product() > 0


def test_other_threads_keep_theirs():
    found = []
    other = threading.Thread(target=lambda: (begin.wait(), found.append(product())))
    begin = threading.Event()
    other.start()
    with flushed_denormals():
        begin.set()
        other.join()
    assert found[0] > 0


def test_rounding_is_as_before():
    with flushed_denormals():
        inside = np.float64(0.1) + np.float64(0.2)
    assert inside == 0.1 + 0.2
