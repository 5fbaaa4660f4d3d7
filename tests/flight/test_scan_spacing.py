"""What a scan reports of itself: its incidence, and how far apart its beams meet level ground."""

import numpy as np
import pytest

from sionna_radar.flight.scan import Scan, build_scan
from sionna_radar.scenario.radar import ScanTable

HEIGHT_M, SPEED_MPS, RATE_HZ = 50.0, 10.0, 360.0


def spacing_m(**table: object) -> float:
    return build_scan(ScanTable(**table)).spacing_m(HEIGHT_M, SPEED_MPS, RATE_HZ)


@pytest.mark.parametrize("mode", ["whisk_broom", "conical", "fixed", "side_looking"])
@pytest.mark.parametrize("incidence_deg", [0.0, 35.0, 60.0])
def test_the_incidence_is_the_boresights_in_the_middle_of_the_scan(mode, incidence_deg):
    scan = build_scan(ScanTable(mode=mode, incidence_deg=incidence_deg))
    assert isinstance(scan, Scan)
    assert scan.incidence_rad == pytest.approx(np.deg2rad(incidence_deg))
    down = scan.point(np.zeros(1)).R_mount_antenna[0, 2, 0]
    assert np.arccos(np.clip(down, -1, 1)) == pytest.approx(scan.incidence_rad, abs=1e-7)


@pytest.mark.parametrize("mode", ["fixed", "side_looking"])
def test_a_beam_that_stands_still_moves_with_the_platform(mode):
    assert spacing_m(mode=mode) == pytest.approx(SPEED_MPS / RATE_HZ, rel=1e-12)


@pytest.mark.parametrize("rpm", [6.0, 60.0, 120.0])
def test_lines_of_a_slow_antenna_lie_a_turn_of_flight_apart(rpm):
    assert spacing_m(mode="whisk_broom", incidence_deg=0.0, half_swath_deg=10.0, rotation_rpm=rpm) == pytest.approx(
        SPEED_MPS * 60 / rpm, rel=1e-12
    )


def places_m(scan: Scan, time_s: np.ndarray) -> np.ndarray:
    """Return where the beams of a platform at rest meet level ground, forward and right."""
    boresight = scan.point(time_s).R_mount_antenna[:, :, 0]
    return HEIGHT_M * boresight[:, :2] / boresight[:, 2:]


@pytest.mark.parametrize("incidence_deg", [0.0, 30.0, 45.0])
def test_beams_of_a_fast_whisk_broom_are_no_farther_apart_than_reported(incidence_deg):
    """h / (cos i cos^2 b) times the step of the scan angle b: exact below the track, a bound beside it."""
    scan = build_scan(
        ScanTable(mode="whisk_broom", incidence_deg=incidence_deg, half_swath_deg=50.0, rotation_rpm=3000.0)
    )
    reported = scan.spacing_m(HEIGHT_M, SPEED_MPS, RATE_HZ)
    edge, turn_rad_s, step_s = np.deg2rad(50.0), 100 * np.pi, 1e-8
    expected = HEIGHT_M / np.cos(edge) ** 2 / np.cos(scan.incidence_rad) * turn_rad_s / RATE_HZ
    assert reported == pytest.approx(expected, rel=1e-12)
    for angle in np.linspace(-edge, edge, 41):
        one, other = places_m(scan, (angle + np.array([-0.5, 0.5]) * turn_rad_s * step_s) / turn_rad_s)
        apart_m = np.linalg.norm(other - one) / step_s / RATE_HZ
        assert apart_m <= reported * (1 + 1e-6)
    if incidence_deg == 0:
        assert apart_m == pytest.approx(reported, rel=1e-6)


def test_beams_of_a_fast_cone_lie_on_a_circle():
    """The circle has the radius h tan i, and each chirp turns the antenna by 2 pi rpm / 60 / rate."""
    scan = build_scan(ScanTable(mode="conical", incidence_deg=40.0, half_swath_deg=180.0, rotation_rpm=1200.0))
    reported = scan.spacing_m(HEIGHT_M, SPEED_MPS, RATE_HZ)
    assert reported == pytest.approx(HEIGHT_M * np.tan(np.deg2rad(40.0)) * 2 * np.pi * 20 / RATE_HZ, rel=1e-12)
    one, other = places_m(scan, np.array([0.0, 1e-6]))
    assert reported == pytest.approx(np.linalg.norm(other - one) / 1e-6 / RATE_HZ, rel=1e-4)


@pytest.mark.parametrize("mode", ["whisk_broom", "conical"])
def test_twice_the_height_and_speed_at_the_same_rates_are_twice_the_spacing(mode):
    scan = build_scan(ScanTable(mode=mode))
    once, twice = scan.spacing_m(50.0, 10.0, 360.0), scan.spacing_m(100.0, 20.0, 360.0)
    assert twice == pytest.approx(2 * once, rel=1e-12)
