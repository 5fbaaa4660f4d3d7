"""Windows, point sets and sums of exponentials without SciPy's slow packages: as with them."""

import numpy as np
import pytest
import scipy.signal
from scipy.special import logsumexp
from scipy.stats.qmc import Halton

from sionna_radar.foundation.numerics import log_sum_exp
from sionna_radar.foundation.sequences import halton
from sionna_radar.foundation.windows import COSINES, taylor, window


@pytest.mark.parametrize("name", [*COSINES, "bartlett"])
@pytest.mark.parametrize("samples", [1, 7, 1024])
def test_windows_are_those_of_scipy(name, samples):
    np.testing.assert_array_equal(window(name, samples), scipy.signal.get_window(name, samples))


@pytest.mark.parametrize(("count", "nbar", "down_db"), [(1, 4, 20.0), (32, 4, 30.0), (65, 6, 25.0)])
def test_taylor_windows_are_those_of_scipy(count, nbar, down_db):
    expected = scipy.signal.windows.taylor(count, nbar=nbar, sll=down_db, norm=False)
    np.testing.assert_array_equal(taylor(count, nbar, down_db), expected)


def test_halton_points_are_those_of_scipy():
    np.testing.assert_array_equal(halton(3000), Halton(2, scramble=False).random(3000))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("axis", [0, 1, None])
def test_sums_of_exponentials_are_those_of_scipy(kind, axis):
    values = (30 * np.random.default_rng(1).normal(size=(20, 40))).astype(kind)
    values[:, 3] = values[:, 7]
    values[5, ::2] = values[6] = values[:, 9] = -np.inf
    for scale in (kind(1), kind(0.01)):
        for keepdims in (True, False):
            expected = logsumexp(scale * values, axis=axis, keepdims=keepdims)
            found = log_sum_exp(scale * values, axis, keepdims)
            np.testing.assert_allclose(found, expected, rtol=4 * np.finfo(kind).eps, strict=True)
