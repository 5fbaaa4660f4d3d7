"""Statistics of altimeter readings on series with known lags, drop-outs and errors."""

import numpy as np
import pytest

from sionna_radar.accuracy.readings import latency, readings_of

TIME_S = np.arange(0.0, 30.0, 0.025)


def heights(time_s: np.ndarray) -> np.ndarray:
    """A flight over two wave lengths of ground, m."""
    return 40.0 + 3.0 * np.sin(2 * np.pi * time_s / 9.0) + 1.5 * np.sin(2 * np.pi * time_s / 5.3 + 1.0)


@pytest.mark.parametrize("lag_s", [-0.3, 0.0, 0.08, 1.2])
def test_a_shifted_series_has_its_lag(lag_s):
    found_s, sigma_s = latency(TIME_S, heights(TIME_S - lag_s) - 0.4, heights(TIME_S))
    assert found_s == pytest.approx(lag_s, abs=0.01)
    assert sigma_s < 0.05


def test_a_first_order_loop_is_late_by_its_time_constant():
    """tau dy/dt = x - y delays slow waves by atan(w tau) / w: 0.199 and 0.196 s here, tau = 0.2 s."""
    read, gain = heights(TIME_S).copy(), 1 - np.exp(-0.025 / 0.2)
    for row in range(1, len(read)):
        read[row] = read[row - 1] + gain * (heights(TIME_S[row]) - read[row - 1])
    found_s, _ = latency(TIME_S, read, heights(TIME_S))
    # A discrete loop is (1 - a) / a samples late.
    assert found_s == pytest.approx(0.025 * (1 - gain) / gain, abs=0.01)


def test_lags_of_noisy_readings_lie_in_their_intervals():
    rng, inside = np.random.default_rng(5), 0
    for _ in range(100):
        noisy = heights(TIME_S - 0.5) + 0.3 * rng.normal(size=len(TIME_S))
        found_s, sigma_s = latency(TIME_S, noisy, heights(TIME_S))
        inside += abs(found_s - 0.5) < 1.96 * sigma_s
    assert 87 <= inside < 100  # outside with a probability below 0.01


def test_level_flight_over_level_ground_tells_no_lag():
    rng = np.random.default_rng(6)
    assert latency(TIME_S, 40 + 0.1 * rng.normal(size=len(TIME_S)), np.full(len(TIME_S), 40.0)) is None
    nearly = 40 + 1e-4 * np.sin(TIME_S)
    assert latency(TIME_S, nearly + 0.1 * rng.normal(size=len(TIME_S)), nearly) is None


def test_statistics_drop_outs_and_clearance_are_those_of_each_cover():
    true_m = np.full(100, 30.0)
    cover = tuple(["soil"] * 60 + ["trees"] * 40)
    reading_m = np.where(np.arange(100) < 60, 30.0 - 0.2, 18.0)
    reading_m[10:14] = np.nan
    reading_m[97:] = np.nan
    clearance_m = np.where(np.arange(100) < 60, 30.0, 17.5)
    found = readings_of("vertical", np.arange(100) * 0.1, reading_m, true_m, clearance_m, cover)
    soil, trees = found.by_cover["soil"], found.by_cover["trees"]
    assert (soil.bias_m, soil.std_m, soil.drop_outs) == (pytest.approx(-0.2), pytest.approx(0.0, abs=1e-9), 4)
    assert (trees.bias_m, trees.le95_m, trees.lowest_clearance_m) == (-12.0, 12.0, 17.5)
    assert (found.errors.pulses, found.errors.drop_outs) == (100, 7)
    assert found.longest_drop_out_s == pytest.approx(0.4)
    assert found.latency_s is None
    assert "17.50 m over 'trees'" in found.described()["lowest clearance flown"]


def test_a_flight_without_any_reading_is_all_drop_outs():
    nothing, flown = np.full(80, np.nan), np.full(80, 20.0)
    found = readings_of("vertical", np.arange(80) * 0.1, nothing, flown, flown, ("soil",) * 80)
    assert found.errors.drop_outs == 80
    assert found.longest_drop_out_s == pytest.approx(8.0)
    assert found.described()["drop-outs"] == "80 of 80 pulses (100.0%), the longest 8 s"
    assert "no reading" in found.described().values()
