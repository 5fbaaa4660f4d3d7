"""Sums of complex exponentials, beside the sums written out."""

import numpy as np
import pytest

from sionna_radar.signal.beat_sum import exponential_sums


@pytest.mark.parametrize("samples", [16, 255, 1024])
def test_the_sums_are_those_written_out(samples):
    random = np.random.default_rng(1)
    first = np.array([0, 40, 40, 90])
    last = np.array([40, 40, 90, 91])
    frequency = np.concatenate([random.uniform(-2, 2, 89), [0.0, 0.5]])
    weight = random.normal(size=91) + 1j * random.normal(size=91)
    bend = np.array([0.0, 1e-6, -2e-7, 1e-5])
    number = np.arange(samples) - samples // 2
    found = exponential_sums(first, last, frequency, weight, bend, samples)
    for row, (a, b) in enumerate(zip(first, last, strict=True)):
        cycles = np.outer(number, frequency[a:b]) + bend[row] * number[:, None] ** 2
        expected = np.exp(2j * np.pi * cycles) @ weight[a:b]
        np.testing.assert_allclose(found[row], expected, atol=1e-7 * np.sqrt(max(b - a, 1)))


def test_rows_in_threads_are_the_rows_alone():
    random = np.random.default_rng(2)
    first = np.arange(64) * 20
    frequency, weight = random.uniform(0, 0.5, 1280), random.normal(size=1280) + 0j
    whole = exponential_sums(first, first + 20, frequency, weight, np.zeros(64), 128)
    for row in (0, 1, 33, 63):
        alone = exponential_sums(first[[row]], first[[row]] + 20, frequency, weight, np.zeros(1), 128)
        np.testing.assert_array_equal(alone[0], whole[row])
