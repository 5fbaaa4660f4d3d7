"""Bursts of chirps: consecutive ones of one scan, each with its own random numbers."""

import numpy as np
import pytest

from sionna_radar import load_scenario
from sionna_radar.flight.pulses import in_bursts
from sionna_radar.survey.preparation import prepare


@pytest.fixture(scope="module")
def schedule():
    return prepare(load_scenario("hills", {"platform.length_m": 12.0, "terrain.spacing_m": 2.0})).flight


def test_a_burst_is_as_many_consecutive_chirps_of_one_scan(schedule):
    bursts = in_bursts(schedule, 7, 360.0)
    pulses = bursts.schedule.pulses(np.arange(len(bursts.schedule)))
    chirps = bursts.chirps_of(pulses)
    np.testing.assert_array_equal(chirps.index, np.arange(7 * len(pulses)))
    time_s = chirps.time_s.reshape(-1, 7)
    np.testing.assert_allclose(np.diff(time_s, axis=1), 1 / 360.0, rtol=1e-9)
    np.testing.assert_allclose(time_s.mean(axis=1), pulses.time_s, rtol=1e-12)
    assert np.abs(schedule.time_s[:, None] - time_s.ravel()).min(axis=0).max() < 1e-9
    assert np.all(chirps.scan_number.reshape(-1, 7) == pulses.scan_number[:, None])
    per_scan = np.bincount(schedule.scan_numbers)
    assert len(pulses) == np.sum(per_scan // 7)


def test_the_middle_chirp_is_where_the_pulse_is(schedule):
    bursts = in_bursts(schedule, 3, 360.0)
    pulses = bursts.schedule.pulses(np.arange(5))
    chirps = bursts.chirps_of(pulses)
    np.testing.assert_allclose(chirps.true.position_m[1::3], pulses.true.position_m, atol=1e-9)
    np.testing.assert_array_equal(chirps.measured.position_m[::3], pulses.measured.position_m)


def test_a_stagger_makes_every_second_interval_longer():
    keys = {"platform.length_m": 4.0, "terrain.spacing_m": 2.0, "radar.scan.half_swath_deg": 180.0}
    keys |= {"radar.scan.mode": "conical", "radar.scan.incidence_deg": 20.0}
    even = prepare(load_scenario("hills", keys)).flight.time_s
    staggered = prepare(load_scenario("hills", keys | {"radar.stagger": 0.25})).flight.time_s
    np.testing.assert_allclose(np.diff(staggered)[::2], 1 / 360.0, rtol=1e-9)
    np.testing.assert_allclose(np.diff(staggered)[1::2], 1.25 / 360.0, rtol=1e-9)
    assert staggered[-1] <= even[-1] + 1e-9
    assert len(staggered) == pytest.approx(len(even) / 1.125, abs=1)


def test_a_single_chirp_is_no_burst(schedule):
    assert in_bursts(schedule, 1, 360.0) is None
