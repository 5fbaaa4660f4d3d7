"""Cosine and sine of turns against extended precision."""

import numpy as np
import pytest

from sionna_radar.foundation.compiled import compiled, turned

pytestmark = pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="no precision beyond double here")


@compiled
def _all(turns, cosine, sine):
    for k in range(len(turns)):
        cosine[k], sine[k] = turned(turns[k])


@pytest.mark.parametrize("scale", [1e-9, 0.5, 3.0, 1e6])
def test_both_functions_are_right_to_the_last_bit_or_two(scale):
    turns = np.random.default_rng(5).uniform(-scale, scale, 20_000)
    cosine, sine = np.empty((2, len(turns)))
    _all(turns, cosine, sine)
    angle = 8 * np.arctan(np.longdouble(1)) * (turns.astype(np.longdouble) - np.round(turns))
    assert np.abs(cosine - np.cos(angle)).max() < 2**-52
    assert np.abs(sine - np.sin(angle)).max() < 2**-52


def test_eighths_of_turns():
    turns = np.arange(-16, 17) / 8
    cosine, sine = np.empty((2, len(turns)))
    _all(turns, cosine, sine)
    root = np.sqrt(0.5)
    expected = np.tile([1, root, 0, -root, -1, -root, 0, root], 5)
    np.testing.assert_allclose(cosine, expected[: len(turns)], atol=2e-16)
    np.testing.assert_allclose(sine, np.roll(expected, 2)[: len(turns)], atol=2e-16)
