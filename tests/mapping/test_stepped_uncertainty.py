"""Cells beside steps: how likely they are of the other side, and what that adds to their standard deviation."""

import numpy as np
import pytest
from scipy.integrate import quad

from sionna_radar import load_scenario, run
from sionna_radar.mapping.stepped.uncertainty import doubt_of_rivals


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
