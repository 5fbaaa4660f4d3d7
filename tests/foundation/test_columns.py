"""Tables of columns: rows keep together, and nothing is lost between taking apart and putting together."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sionna_radar.foundation.columns import Columns


@dataclass(frozen=True, kw_only=True)
class Walk(Columns):
    step: np.ndarray
    place_m: np.ndarray


def walk(count: int = 6) -> Walk:
    """Return a table whose second column says which row it belongs to."""
    step = np.arange(count)
    return Walk(step=step, place_m=np.column_stack([10.0 * step, -10.0 * step]))


@pytest.mark.parametrize(
    "chosen",
    [np.array([4, 0, 4]), np.array([False, True, False, False, True, True]), slice(1, 5, 2), np.zeros(0, dtype=int)],
    ids=["numbers", "mask", "slice", "none"],
)
def test_chosen_rows_stay_whole(chosen):
    some = walk().rows(chosen)
    assert isinstance(some, Walk)
    np.testing.assert_array_equal(some.step, np.arange(6)[chosen])
    assert len(some) == len(some.step)
    assert some.place_m.shape == (len(some), 2)
    np.testing.assert_array_equal(some.place_m[:, 0], 10.0 * some.step)


@given(st.lists(st.integers(0, 12), max_size=4))
def test_parts_put_together_are_the_whole(cuts):
    whole = walk(12)
    edges = [0, *sorted(cuts), 12]
    together = Walk.concatenate([whole.rows(slice(a, b)) for a, b in pairwise(edges)])
    assert isinstance(together, Walk)
    np.testing.assert_array_equal(together.step, whole.step)
    np.testing.assert_array_equal(together.place_m, whole.place_m)
