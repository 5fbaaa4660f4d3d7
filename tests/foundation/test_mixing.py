"""Random numbers of places: the same whenever a place is met, and those of no other place, use or seed."""

import numpy as np
import pytest

from sionna_radar.foundation.randomness import place_uniforms

PLACES = np.random.default_rng(1).uniform(-1e4, 1e4, (50_000, 3))


@pytest.mark.parametrize("seed", [0, 1, 2**63 - 1])
def test_they_are_even_and_independent_of_each_other(seed):
    number = place_uniforms(seed, 13, PLACES, 2)
    assert np.all((number >= 0) & (number < 1))
    np.testing.assert_allclose(np.histogram(number, bins=10)[0] / number.size, 0.1, atol=0.003)
    other = place_uniforms(seed, 14, PLACES, 2)
    mixed = np.corrcoef([*number.T, *other.T, *place_uniforms(seed ^ 1, 13, PLACES, 2).T, *PLACES.T])
    assert np.abs(mixed - np.eye(len(mixed))).max() < 0.02


def test_they_belong_to_the_place_whatever_its_neighbours_and_its_precision():
    whole = place_uniforms(5, 13, PLACES, 3)
    np.testing.assert_array_equal(place_uniforms(5, 13, PLACES[777:900], 3), whole[777:900])
    single = PLACES.astype(np.float32)
    np.testing.assert_array_equal(place_uniforms(5, 13, single, 3), place_uniforms(5, 13, single.copy(), 3))
    nudged = place_uniforms(5, 13, PLACES + np.array([0.0, 0.0, 1e-3]), 1)
    assert np.mean(nudged == whole[:, :1]) < 1e-3
