"""Cells beside steps: how likely they are of the other side, and what that adds to their standard deviation."""

import numpy as np
import pytest
from scipy.integrate import quad

from sionna_radar import load_scenario, run
from sionna_radar.mapping.stepped.uncertainty import BESIDE_STEP, doubt_of_rivals, unseen_steps


def test_doubt_is_how_often_two_rivals_differ_and_by_how_much():
    rng = np.random.default_rng(2)
    excess = np.array([40.0, 400.0, 90.0])
    off_m = rng.choice([0.0, 3.0, -5.0], (4, 2, 3))
    chance, square_m2 = doubt_of_rivals(excess, off_m)
    # A proposal without an energy is drawn as often as the mean of the others.
    weight = np.array([*(0.75 * (1 / excess) / np.sum(1 / excess)), 0.25])
    one, other = rng.choice(4, (2, 200_000), p=weight)
    both = (off_m[one] != 0) & (off_m[other] != 0)
    np.testing.assert_allclose(chance, both.mean(axis=0), atol=0.005)
    np.testing.assert_allclose(square_m2, np.mean(both * off_m[one] ** 2, axis=0), atol=0.1)


def test_a_rival_weighs_the_mean_of_its_likelihood_over_the_unknown_discount():
    excess = np.array([30.0, 900.0])
    mean = [quad(lambda d, nepers=nepers: np.exp(-d * nepers), 0, np.inf)[0] for nepers in excess]
    off_m = np.zeros((3, 1, 1))
    off_m[0] = 2.0
    assert np.sqrt(doubt_of_rivals(excess, off_m)[0][0, 0]) == pytest.approx(2 / 3 * mean[0] / sum(mean), rel=1e-6)


def test_without_rivals_the_echo_alone_is_asked():
    off_m = np.array([[[0.0, 4.0]]])
    chance, square_m2 = doubt_of_rivals(np.zeros(0), off_m)
    np.testing.assert_array_equal(chance, [[0.0, 1.0]])
    np.testing.assert_array_equal(square_m2, [[0.0, 16.0]])


def test_cells_beside_steps_may_be_crossed_by_them_and_others_less_with_the_cube_of_the_distance():
    height = np.zeros((7, 24))
    height[:, 8:16], height[:, 16:] = 6.0, 15.0
    open_m = np.zeros(height.shape)
    chance, square_m2 = unseen_steps(height, open_m, 2.0)
    np.testing.assert_allclose(chance[3, 4:12] / BESIDE_STEP, [1 / 64, 1 / 27, 1 / 8, 1, 1, 1 / 8, 1 / 27, 1 / 64])
    # By the step of the nearest border.
    np.testing.assert_allclose(square_m2[3, 8:16] / chance[3, 8:16], [36.0] * 4 + [81.0] * 4)
    open_m[3, 2] = 4.0
    chance, square_m2 = unseen_steps(height, open_m, 2.0)
    assert chance[3, 1] == BESIDE_STEP
    assert square_m2[3, 1] == pytest.approx(BESIDE_STEP * 16.0)


def test_a_hillside_without_steps_has_no_other_side():
    height = np.add.outer(np.zeros(30), 0.4 * np.arange(40))
    chance, square_m2 = unseen_steps(height, np.zeros(height.shape), 1.2)
    assert not chance.any()
    assert not square_m2.any()


def test_a_survey_over_boxes_states_its_gross_errors():
    """Where a cell is wrong by a step that is stated, to a factor, and it is left out where that is likely."""
    survey = run(
        load_scenario(
            "buildings", {"seed": 33, "platform.length_m": 40.0, "dem.method_parameters": {"max_other_side": 0.99}}
        )
    )
    cells = survey.lit & survey.error.filled
    error_m, sigma_m = survey.error.height_m[cells], survey.dem_sigma.height_m[cells]
    wrong, stated = np.abs(error_m) > 2.0, survey.uncertainty.other_side[cells]
    assert np.sqrt(np.mean((error_m / sigma_m) ** 2)) < 3
    assert 10 < wrong.sum() < 2 * stated.sum() < 6 * wrong.sum()
    assert np.mean(wrong[stated < 0.1]) < 0.2 * np.mean(wrong)
