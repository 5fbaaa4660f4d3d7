"""The first-order loop of a tracker: against its closed forms, a plain convolution, and flown."""

import numpy as np
import pytest

from sionna_radar import Execution, load_scenario, run
from sionna_radar.detection.ranging.estimators import RangeLoop, Ranges
from sionna_radar.foundation.errors import ScenarioError

TAU_S, PERIOD_S = 0.09, 8 / 143
GAIN = 1 - np.exp(-PERIOD_S / TAU_S)
FLOWN = {
    "terrain": {"kind": "flat", "size_m": [600.0, 600.0]},
    "platform": {"altitude_m": 100.0, "speed_mps": 10.0, "length_m": 30.0},
    "radar": {"preset": "alt_4300"},
    "tracing.speckle": "per_pulse",
    "processing.average": {"chirps": 8, "mode": "incoherent"},
    "processing.cfar.kind": "CA",
    "processing.volume_clutter": "off",
    "dem": {"method": "linear", "spacing_m": 10.0},
}
TRACKED = FLOWN | {"processing.ranging": "tracker", "processing.ranging_parameters.time_constant_s": TAU_S}


def followed(time_s: np.ndarray, range_m: np.ndarray, sigma_m: float = 0.0) -> Ranges:
    ranges = Ranges(range_m=range_m, sigma_m=np.full(len(range_m), sigma_m))
    return RangeLoop(time_constant_s=TAU_S).follow(time_s, ranges)


def test_spread_and_correlation_of_white_errors_are_those_of_a_first_order_filter():
    count, sigma_m = 200_000, 0.3
    white_m = np.random.default_rng(1).normal(100.0, sigma_m, count)
    smoothed = followed(PERIOD_S * np.arange(count), white_m, sigma_m)
    left_m, expected_m = smoothed.range_m[100:] - 100.0, sigma_m * np.sqrt(GAIN / (2 - GAIN))
    assert np.std(left_m) == pytest.approx(expected_m, rel=0.01)
    np.testing.assert_allclose(smoothed.sigma_m[100:], expected_m, rtol=1e-9)
    for lag in (1, 2, 5):
        correlation = np.mean(left_m[lag:] * left_m[:-lag]) / np.var(left_m)
        assert correlation == pytest.approx((1 - GAIN) ** lag, abs=0.01)


def test_a_ramp_is_followed_late_by_a_time():
    time_s = PERIOD_S * np.arange(400)
    behind_m = 3.0 * time_s - followed(time_s, 3.0 * time_s).range_m
    assert behind_m[-1] == pytest.approx(3.0 * PERIOD_S * (1 - GAIN) / GAIN)


def test_pulses_without_an_echo_and_parts_of_a_flight():
    rng = np.random.default_rng(2)
    time_s = np.sort(rng.uniform(0.0, 5.0, 80))
    range_m, sigma_m = rng.normal(100.0, 1.0, 80), rng.uniform(0.1, 0.5, 80)
    # The convolution with exp(-t / tau) / tau of what is held from pulse to pulse, from the first range on.
    age_s = time_s[:, None] - np.concatenate([[-np.inf], time_s])
    share = np.where(age_s >= 0, np.exp(-np.maximum(age_s, 0.0) / TAU_S), 1.0)
    weight = np.diff(share, axis=1)
    whole = followed(time_s, range_m)
    np.testing.assert_allclose(whole.range_m, weight @ range_m)
    loop = RangeLoop(time_constant_s=TAU_S)
    parts = [
        loop.follow(time_s[part], Ranges(range_m=range_m[part], sigma_m=sigma_m[part]))
        for part in (slice(0, 33), slice(33, 34), slice(34, 34), slice(34, 80))
    ]
    np.testing.assert_array_equal(np.concatenate([part.range_m for part in parts]), whole.range_m)
    np.testing.assert_allclose(np.concatenate([part.sigma_m for part in parts]), np.sqrt(weight**2 @ sigma_m**2))


def test_a_flight_is_that_of_its_estimator_smoothed_whatever_the_blocks():
    plain = run(load_scenario("hills", FLOWN | {"processing.ranging": "threshold"}))
    tracked = run(load_scenario("hills", TRACKED), execution=Execution(block_size=64))
    time_s = plain.prepared.flight.time_s[plain.points.pulse]
    expected = RangeLoop(time_constant_s=TAU_S).follow(
        time_s, Ranges(range_m=plain.points.range_m, sigma_m=plain.points.range_sigma_m)
    )
    np.testing.assert_array_equal(tracked.points.range_m, expected.range_m)
    np.testing.assert_array_equal(tracked.points.range_sigma_m, expected.sigma_m)
    assert np.std(tracked.points.range_m[10:]) < 0.7 * np.std(plain.points.range_m[10:])
    echoes = tracked.prepared.echoes(np.arange(len(tracked.prepared)))
    np.testing.assert_array_equal(echoes.range_m, expected.range_m)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"processing.echoes": "all"}, "of which it follows one"),
        ({"radar.scan": {"mode": "whisk_broom"}}, "set radar.scan.mode = 'fixed'"),
        ({"processing.ranging_parameters.time_constant_s": 0.0}, "must be greater than 0"),
    ],
)
def test_what_a_tracker_cannot_follow_is_refused(keys, words):
    with pytest.raises(ScenarioError, match=words):
        load_scenario("hills", TRACKED | keys)
