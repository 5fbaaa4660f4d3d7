"""Cells beside steps: how likely they are of the other side, and what that adds to their standard deviation."""

from itertools import product

import numpy as np
import pytest
from scipy.stats import norm

from sionna_radar import load_scenario, run
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.options import STEPPED
from sionna_radar.mapping.stepped.coarse_map import CoarseMap, choose_levels, margins, path_costs
from sionna_radar.mapping.stepped.uncertainty import (
    ABOVE_M,
    BELOW_M,
    DISTANCES_CELLS,
    nearest_step_below,
    stepped_uncertainty,
)


def coarse(height_m: np.ndarray, margin: float = 0.0, depth_m: float = 0.0) -> CoarseMap:
    """A coarse map that is the map itself, with levels left open as far below and above."""
    whole = (np.full(height_m.shape, value) for value in (True, margin, margin, depth_m, depth_m))
    return CoarseMap(height_m, *whole, level_m=0.3)


def test_margins_of_a_row_are_those_of_a_plain_search():
    """The best heights of all cells of a row, with the level of one cell held a step or more away."""
    rng, apart = np.random.default_rng(7), 2
    for _ in range(10):
        cost = rng.uniform(0, 12, (1, 5, 4)).astype(np.float32)
        rows = np.array(list(product(range(4), repeat=5)))
        step = np.abs(np.diff(rows, axis=1))
        changes = STEPPED.change_nepers * (step == 1) + STEPPED.jump_nepers * (step > 1)
        of_row = cost[0, np.arange(5), rows].sum(axis=1) + changes.sum(axis=1)
        chosen = choose_levels(cost)
        below, above, depth, rise = margins(cost, path_costs(cost), chosen, apart)
        for column in range(5):
            best = np.array([of_row[rows[:, column] == level].min() for level in range(4)])
            level = chosen[0, column]
            own = best[max(level - 1, 0) : level + 2].min()
            down = best[: max(level - apart + 1, 0)].min(initial=np.inf)
            up = best[level + apart :].min(initial=np.inf)
            assert below[0, column] == pytest.approx(max(down - own, 0) / 8, rel=1e-4, abs=1e-4)
            assert above[0, column] == pytest.approx(max(up - own, 0) / 8, rel=1e-4, abs=1e-4)
            away, likelihood = np.arange(4) - level, np.exp(-best / 8)
            for found, side in ((depth, away <= -apart), (rise, away >= apart)):
                square = np.average(away[side] ** 2, weights=likelihood[side]) if side.any() else 0.0
                assert found[0, column] == pytest.approx(np.sqrt(square), rel=1e-4)


def test_the_next_step_is_that_of_a_plain_search():
    """Of growing squares the first with a foot of a step below the cell; as deep as in one twice as wide."""
    rng = np.random.default_rng(3)
    height = np.round(rng.uniform(0, 1.5, (26, 31)) ** 8, 1)
    away, depth_m = nearest_step_below(height, 1.2, 0.5)
    place = np.argwhere(np.ones(height.shape, dtype=bool)).reshape(*height.shape, 2)
    foot = np.zeros(height.shape, dtype=bool)
    for i, j in product(range(26), range(31)):
        foot[i, j] = height[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2].max() - height[i, j] > 1.2
    for i, j in product(range(0, 26, 3), range(0, 31, 3)):
        apart = np.abs(place - [i, j]).max(axis=-1)
        lower = foot & (height[i, j] - height > 1.2)
        first = min((cells for cells in DISTANCES_CELLS if (lower & (apart <= cells)).any()), default=np.inf)
        assert away[i, j] == first / 2
        if np.isfinite(first):
            reach = max(cells for cells in DISTANCES_CELLS if cells <= max(2 * first, 8))
            assert depth_m[i, j] == pytest.approx(height[i, j] - height[lower & (apart <= reach)].min())
        else:
            assert depth_m[i, j] == 0.0


def test_a_cell_beside_a_step_is_wrong_by_the_step_as_often_as_is_said():
    """The variance that is added is that of drawn errors: a step up or down with their probabilities, and none else."""
    height = np.zeros((8, 24))
    height[:, 8:16], height[:, 16:] = 6.0, 15.0
    found = stepped_uncertainty(np.full(height.shape, 0.1), height, coarse(height), 2.0, 1.0)
    # Columns of the middle roof: 6 m above the ground, three cells away, and 9 m below the other, six cells away.
    down, up = BELOW_M / 3, ABOVE_M / 6
    chance = np.array([down, up, 1.0]) / (1 + down + up)
    assert np.all(found.other_side[:, 10] == pytest.approx(chance[:2].sum()))
    rng = np.random.default_rng(1)
    wrong = rng.choice([-6.0, 9.0, 0.0], 400_000, p=chance) + 0.1 * rng.standard_normal(400_000)
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=24, rows=8)
    sigma = found.sigma_m(grid, np.ones(grid.shape, dtype=bool))
    assert sigma[3, 10] == pytest.approx(wrong.std(), rel=0.01)
    assert sigma[3, 10] ** 2 - found.step_sigma_m[3, 10] ** 2 == pytest.approx(0.1**2)


def test_an_error_is_as_deep_as_what_the_echoes_leave_open():
    """Beside a lower roof a cell may be a light well down to the street; a border that moved it counts, too."""
    height = np.zeros((8, 24))
    height[:, 8:] = 6.0
    own = np.full(height.shape, 0.1)
    near, deep = (
        stepped_uncertainty(own, height, coarse(height, depth_m=depth_m), 2.0, 1.0) for depth_m in (3.0, 12.0)
    )
    square = [
        found.step_sigma_m[3, 10] ** 2 / (chance := found.other_side[3, 10]) / (1 - chance) for found in (near, deep)
    ]
    assert square == pytest.approx([6.0**2, 12.0**2])
    moved = stepped_uncertainty(own, height, coarse(height - 5.0, depth_m=9.0), 2.0, 1.0)
    assert moved.step_sigma_m[3, 10] == pytest.approx(deep.step_sigma_m[3, 10] * 14 / 12)


def test_what_the_echoes_say_against_another_level_makes_it_less_likely():
    """Margins err by a neper: one of two is as likely as a normal deviate of two, over that of none."""
    height = np.zeros((9, 40))
    height[:, 20:] = 6.0
    own = np.full(height.shape, 0.1)
    odds = []
    for nepers in (0.0, 2.0, np.inf):
        chance = stepped_uncertainty(own, height, coarse(height, nepers), 2.0, 1.0).other_side
        odds.append(chance / (1 - chance))
    np.testing.assert_allclose(odds[1], odds[0] * norm.pdf(2.0) / norm.pdf(0.0))
    assert np.all(odds[2] == 0.0)
    assert np.all(np.diff(odds[0][4, 20:]) <= 0)


def test_a_hillside_without_steps_has_no_other_side():
    height = np.add.outer(np.zeros(30), 0.4 * np.arange(40))
    found = stepped_uncertainty(np.full(height.shape, 0.1), height, coarse(height, depth_m=8.0), 1.2, 1.0)
    assert np.all(found.other_side == 0.0)
    assert np.all(found.cell_sigma_m == pytest.approx(0.1))


def test_a_survey_over_boxes_states_its_gross_errors():
    """24 cells are stated, and 19 are wrong by over 2 m: RMS of z 0.5, by the margins of single cells 13.7."""
    survey = run(load_scenario("buildings", {"seed": 33, "platform.length_m": 40.0}))
    cells = survey.lit & survey.error.filled
    error_m, sigma_m = survey.error.height_m[cells], survey.dem_sigma.height_m[cells]
    wrong, stated = np.abs(error_m) > 2.0, survey.uncertainty.other_side[cells]
    assert np.sqrt(np.mean((error_m / sigma_m) ** 2)) < 3
    assert 10 < wrong.sum() < 2 * stated.sum() < 6 * wrong.sum()
    assert stated[wrong].min() > 0.001
