"""Indices spread over a range: one in each part, whatever the period of what they look at."""

import numpy as np
import pytest

from sionna_radar.foundation.sequences import spread_indices


@pytest.mark.parametrize(("count", "total"), [(10, 7), (7, 7)])
def test_few_are_all_taken(count, total):
    assert spread_indices(count, total).tolist() == list(range(total))


@pytest.mark.parametrize(("count", "total"), [(240, 10_000), (17, 1000), (2, 50)])
def test_one_is_in_each_part_and_the_ends_are_among_them(count, total):
    chosen = spread_indices(count, total)
    assert len(chosen) == count
    start = np.arange(count) * total / count
    assert ((chosen > start - 1) & (chosen < start + total / count)).all()
    assert (chosen[0], chosen[-1]) == (0, total - 1)


def test_they_meet_all_phases_of_a_period_that_equal_steps_would_alias_with():
    phase = spread_indices(200, 10_000) % 50
    assert len(np.unique(phase)) > 40
    assert len(np.unique(np.arange(0, 10_000, 50) % 50)) == 1
