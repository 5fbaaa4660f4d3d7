"""Triangular systems by blocks against the plain solution."""

import numpy as np
import pytest

from sionna_radar.foundation.numerics import ROWS, solve_lower


@pytest.mark.parametrize("size", [1, ROWS, 2 * ROWS + 7])
def test_a_triangular_system_is_solved_by_blocks_of_rows(size):
    rng = np.random.default_rng(size)
    root = np.tril(rng.standard_normal((size, size))) / np.sqrt(size) + np.eye(size)
    for right in (rng.standard_normal(size), rng.standard_normal((size, 3))):
        np.testing.assert_allclose(root @ solve_lower(root, right), right, rtol=0, atol=1e-9)
