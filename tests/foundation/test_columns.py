"""Tables of columns: rows keep together, and nothing is lost between taking apart and putting together."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sionna_radar.foundation.columns import Columns, columns_of, packed, table_of
from sionna_radar.foundation.raster import Georeference, Grid, MapCells, Raster


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


@pytest.mark.parametrize("cells", [None, MapCells(corner_m=(0.5, 1.5), size_m=(2.0, 2.0))], ids=["without", "with"])
@pytest.mark.parametrize("placed", [False, True])
def test_tables_inside_a_table_come_back_as_they_were(placed, cells):
    place = Georeference(crs_wkt="a CRS", origin_m=(1.0, 2.0, 3.0), cells=cells) if placed else None
    grid = Grid(west_m=-1.0, south_m=0.1, spacing_m=0.5, columns=3, rows=2, georeference=place)
    raster = Raster(grid=grid, height_m=np.array([[0.1, np.nan, 2.0], [3.0, 4.0, 5.0]]), quantity="height error")
    columns = columns_of(packed(map=raster, walk=walk(2)))
    again = table_of(Raster, "map", columns)
    np.testing.assert_array_equal(again.height_m, raster.height_m)
    assert (again.grid, again.grid.georeference, again.quantity) == (grid, place, "height error")
    assert isinstance(again.grid.columns, int)
    np.testing.assert_array_equal(table_of(Walk, "walk", columns).place_m, walk(2).place_m)
