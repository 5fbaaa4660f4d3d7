"""Least squares with errors that are alike over unknown distances: closed forms, and what intervals hold."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.stats import norm, t

from sionna_radar.accuracy.robust_errors import BLOCKS, blocks_of, robust_fit


def test_the_mean_of_equal_blocks_has_the_error_of_their_means():
    values = np.random.default_rng(1).normal(size=(BLOCKS, 30))
    fit = robust_fit(*2 * [np.ones((values.size, 1))], values.ravel(), np.repeat(np.arange(BLOCKS), 30))
    error = values.mean(axis=1).std(ddof=1) / np.sqrt(BLOCKS)
    assert fit.estimate[0] == pytest.approx(values.mean())
    assert fit.sigma[0] * norm.ppf(0.975) == pytest.approx(error * t.ppf(0.975, BLOCKS - 1))


def test_blocks_are_equally_full_and_no_longer_than_wide():
    place = np.random.default_rng(2).uniform(0, 1, (4001, 2)) * [4.0, 2.0]
    block = blocks_of(place)
    count = np.bincount(block)
    assert len(count) == BLOCKS
    assert np.ptp(count) <= 1
    for number in range(BLOCKS):
        np.testing.assert_allclose(np.ptp(place[block == number], axis=0), [1.0, 1.0], atol=0.2)


def test_fewer_places_than_blocks_are_blocks_of_their_own():
    assert len(set(blocks_of(np.arange(5.0)[:, None]))) == 5


@pytest.mark.parametrize("length", [2, 15, 25])
def test_intervals_hold_where_errors_and_model_are_alike_over_long_distances(length):
    """A trend and a slope of 1,000 data; both errors and slopes are alike over up to a quarter of a block."""
    rng, inside = np.random.default_rng(3), []
    place = np.linspace(-1.0, 1.0, 1000)
    for _ in range(300):
        slope, errors = (gaussian_filter1d(rng.normal(size=1000), length, mode="wrap") for _ in range(2))
        model = np.column_stack([np.ones(1000), place, slope / slope.std()])
        truth = np.array([0.3, -0.2, 0.5])
        fit = robust_fit(model, model, model @ truth + errors / errors.std(), blocks_of(place[:, None]))
        inside.append(np.abs(fit.estimate - truth) < 1.96 * fit.sigma)
    # Of 300 intervals of 95 %, fewer than 272 or more than 296 hold the truth with a probability below 0.002.
    assert np.all(np.abs(np.mean(inside, axis=0) - 0.947) < 0.04)


def test_what_one_block_alone_tells_has_no_finite_error():
    place, told = np.arange(80.0), np.zeros(80)
    told[3] = 1.0
    model = np.column_stack([np.ones(80), told])
    fit = robust_fit(model, model, np.random.default_rng(4).normal(size=80), blocks_of(place[:, None]))
    assert np.isinf(fit.sigma).all()
