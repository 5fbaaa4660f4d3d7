"""Cells beside steps: how likely they are of the other side, and what that adds to their standard deviation."""

import numpy as np
import pytest

from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.stepped.surface import NEPERS, with_steps


def test_a_cell_beside_a_step_is_wrong_by_the_step_as_often_as_is_said():
    """The variance that is added is that of drawn errors: the whole step with the probability, and none else."""
    height = np.zeros((8, 9))
    height[:, 5:] = 6.0
    margin = np.full(height.shape, np.inf)
    margin[:, 4:6] = NEPERS * np.log(2.0)
    found = with_steps(np.full(height.shape, 0.1), height, margin)
    assert np.all(found.other_side[:, 4:6] == pytest.approx(0.25))
    assert np.all(found.other_side[:, :4] == 0.0)
    rng = np.random.default_rng(1)
    wrong = 6.0 * (rng.random(200_000) < 0.25) + 0.1 * rng.standard_normal(200_000)
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=9, rows=8)
    sigma = found.sigma_m(grid, np.ones(grid.shape, dtype=bool))
    assert sigma[3, 4] == pytest.approx(wrong.std(), rel=0.01)
    assert sigma[3, 1] == pytest.approx(0.1)
