"""Scans by phases: the beams of an array, one after another, about a face that stands still."""

import numpy as np
import pytest

from sionna_radar.flight.frames import conical_from_antenna
from sionna_radar.flight.scan import build_scan
from sionna_radar.scenario.radar import ElectronicScanTable


def scan_of(**keys):
    return build_scan(ElectronicScanTable(**{"beams": 5, "half_swath_deg": 30.0, "scans_per_s": 2.0, **keys}))


def test_beams_follow_one_another_from_left_to_right():
    pointing = scan_of().point(np.arange(12) / 10 + 0.01)
    np.testing.assert_array_equal(pointing.beam, [0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1])
    np.testing.assert_array_equal(pointing.scan_number, np.arange(12) // 5)
    assert pointing.active.all()
    assert np.all(np.diff(pointing.scan_rad[:5]) > 0)  # scan angles grow to the right
    assert np.rad2deg(pointing.scan_rad[[0, 2, 4]]) == pytest.approx([-30.0, 0.0, 30.0], abs=1e-9)


@pytest.mark.parametrize(("look", "turn_deg"), [("forward", 0.0), ("left", -90.0), ("right", 90.0)])
def test_a_beam_leaves_the_normal_of_the_face_in_its_plane(look, turn_deg):
    scan = scan_of(look=look, incidence_deg=40.0)
    axes = scan.point(np.arange(5) / 10 + 0.01).R_mount_antenna
    face = conical_from_antenna(np.deg2rad(40.0), np.array([np.deg2rad(turn_deg)]))[0]
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (5, 3, 3)), atol=1e-12)
    boresight = axes[:, :, 0]
    np.testing.assert_allclose(boresight @ face[:, 2], 0.0, atol=1e-12)  # in the plane of normal and left
    # Equal steps of direction cosine, from left to right.
    np.testing.assert_allclose(boresight @ face[:, 1], 0.5 * np.linspace(1, -1, 5), atol=1e-12)
    np.testing.assert_allclose(boresight[2], face[:, 0], atol=1e-12)


def test_the_spacing_is_that_of_the_outermost_beams():
    scan = scan_of(incidence_deg=0.0)
    place = 50 * np.tan(np.arcsin(0.5 * np.linspace(1, -1, 5)))
    assert scan.spacing_m(50.0, 1.0, 100.0) == pytest.approx(np.abs(np.diff(place)).max())
    assert scan.spacing_m(50.0, 100.0, 100.0) == pytest.approx(50.0)  # the way flown during a scan
