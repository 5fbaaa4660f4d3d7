"""Paths made from geometry: delays, range rates and places against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from flights import make_pulses
from sionna_radar.tracing.paths import TARGET, VOLUME, Paths

C = 299_792_458.0
ROW = np.array([2, 0])


def physics(surface: int) -> dict[str, np.ndarray]:
    return {"gain": np.array([1.0, 2j]), "incidence_rad": np.array([0.1, 0.2]), "surface": np.full(2, surface)}


def test_to_a_point_the_delay_is_twice_the_distance_and_the_rate_its_change():
    pulses = make_pulses(3, velocity_mps=(0.0, 10.0, 0.0), position_m=(0.0, 0.0, 40.0), first=7)
    hit_m = np.array([[0.0, 30.0, 0.0], [0.0, -30.0, 0.0]])
    paths = Paths.to_points(pulses, ROW, hit_m, **physics(TARGET))
    np.testing.assert_array_equal(paths.pulse, [9, 7])
    np.testing.assert_allclose(paths.delay_s, 2 * 50.0 / C, rtol=1e-15)
    # Three fifths of the velocity point at the one, away from the other.
    np.testing.assert_allclose(paths.range_rate_mps, [-6.0, 6.0], rtol=1e-15)
    np.testing.assert_array_equal(paths.hit_m, hit_m)
    np.testing.assert_array_equal(paths.gain, [1.0, 2j])
    np.testing.assert_array_equal(paths.surface, [TARGET, TARGET])


def test_the_range_rate_is_the_derivative_of_the_delay():
    """Over a microsecond of flight the delay grows by twice the range rate over the speed of light."""
    step_s, velocity = 1e-6, np.array([3.0, 14.0, -2.0])
    hit_m = np.array([[12.0, 31.0, 2.0], [-4.0, 5.0, 1.0]])
    pulses = make_pulses(3, velocity_mps=tuple(velocity))
    later = make_pulses(3, velocity_mps=tuple(velocity), position_m=tuple([0.0, 0.0, 50.0] + step_s * velocity))
    now, then = (Paths.to_points(p, ROW, hit_m, **physics(0)) for p in (pulses, later))
    rate_mps = (then.delay_s - now.delay_s) / step_s * C / 2
    np.testing.assert_allclose(now.range_rate_mps, rate_mps, atol=1e-5)


@pytest.mark.parametrize("incidence_deg", [0.0, 30.0, 60.0])
def test_along_the_boresight_the_place_lies_on_the_beam(incidence_deg):
    pulses = make_pulses(3, incidence_deg=incidence_deg)
    range_m = np.array([20.0, 35.0])
    paths = Paths.along_boresight(pulses, ROW, range_m, drift_mps=np.array([0.5, -0.5]), **physics(VOLUME))
    forward, down = np.sin(np.deg2rad(incidence_deg)), np.cos(np.deg2rad(incidence_deg))
    expected = np.column_stack([0 * range_m, range_m * forward, 50.0 - range_m * down])
    np.testing.assert_allclose(paths.hit_m, expected, atol=1e-12)
    np.testing.assert_allclose(paths.delay_s, 2 * range_m / C, rtol=1e-15)
    np.testing.assert_allclose(paths.range_rate_mps, -10.0 * forward + np.array([0.5, -0.5]), atol=1e-12)


def test_a_still_point_on_the_boresight_is_the_same_path_either_way():
    pulses, range_m = make_pulses(3, incidence_deg=40.0, scan_deg=25.0, heading_deg=70.0), np.array([60.0, 70.0])
    along = Paths.along_boresight(pulses, ROW, range_m, **physics(0))
    to = Paths.to_points(pulses, ROW, along.hit_m, **physics(0))
    np.testing.assert_allclose(along.delay_s, to.delay_s, rtol=1e-13)
    np.testing.assert_allclose(along.range_rate_mps, to.range_rate_mps, rtol=1e-12)


def test_both_read_the_true_pose_alone():
    pulses = make_pulses(3, incidence_deg=40.0)
    nowhere = replace(
        pulses.measured, **{name: np.full_like(value, np.nan) for name, value in vars(pulses.true).items()}
    )
    blind = replace(pulses, measured=nowhere)
    hit_m, range_m = np.array([[12.0, 31.0, 2.0], [-4.0, 5.0, 1.0]]), np.array([60.0, 70.0])
    for made in (
        lambda p: Paths.to_points(p, ROW, hit_m, **physics(0)),
        lambda p: Paths.along_boresight(p, ROW, range_m, **physics(0)),
    ):
        for name, column in vars(made(pulses)).items():
            np.testing.assert_array_equal(getattr(made(blind), name), column, err_msg=name)


def test_tables_put_together_are_sorted_by_pulse_and_keep_their_order_within_one():
    pulses = make_pulses(3)
    one = Paths.along_boresight(pulses, np.array([0, 2]), np.array([50.0, 50.0]), **physics(0))
    other = Paths.along_boresight(pulses, np.array([0, 1]), np.array([60.0, 60.0]), **physics(1))
    together = Paths.concatenate([one, other])
    np.testing.assert_array_equal(together.pulse, [0, 0, 1, 2])
    np.testing.assert_array_equal(together.surface, [0, 1, 1, 0])
