"""Grids and rasters."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sionna_radar.foundation.raster import Grid, Raster

GRID = Grid(west_m=10.0, south_m=-4.0, spacing_m=2.0, columns=3, rows=2)


def test_cell_centres_run_from_south_west_row_by_row():
    assert GRID.shape == (2, 3)
    np.testing.assert_array_equal(GRID.x_m, [10, 12, 14])
    np.testing.assert_array_equal(GRID.y_m, [-4, -2])
    np.testing.assert_array_equal(GRID.centres_m, [[10, -4], [12, -4], [14, -4], [10, -2], [12, -2], [14, -2]])
    assert GRID.extent_m == (9.0, 15.0, -5.0, -1.0)


@given(st.floats(-500, 500), st.floats(-500, 500), st.floats(0, 300), st.floats(0, 300), st.floats(0.1, 20))
def test_a_covering_grid_covers_on_whole_multiples(west, south, width, height, spacing):
    grid = Grid.covering(west, south, west + width, south + height, spacing)
    slack = 1e-9 * (1000 + spacing)
    assert grid.x_m[0] <= west + slack
    assert grid.x_m[-1] >= west + width - slack
    assert grid.y_m[0] <= south + slack
    assert grid.y_m[-1] >= south + height - slack
    assert grid.x_m[-1] - west - width < spacing + slack
    assert west - grid.x_m[0] < spacing + slack
    assert grid.west_m / spacing == pytest.approx(round(grid.west_m / spacing), abs=1e-6)


def test_heights_between_cells_are_bilinear():
    raster = Raster(grid=GRID, height_m=np.array([[0.0, 2.0, 4.0], [10.0, 12.0, 14.0]]))
    place = np.array([[10.0, -4.0], [11.0, -4.0], [10.0, -3.0], [13.5, -2.5], [14.0, -2.0]])
    np.testing.assert_allclose(raster.at(place), [0.0, 1.0, 5.0, 11.0, 14.0], atol=1e-12)


def test_outside_and_beside_empty_cells_there_is_no_height():
    raster = Raster(grid=GRID, height_m=np.array([[0.0, 2.0, np.nan], [10.0, 12.0, 14.0]]))
    assert np.isnan(raster.at(np.array([[9.0, -4.0], [15.0, -3.0], [13.0, -3.0], [12.0, 0.0]]))).all()
    np.testing.assert_array_equal(raster.filled, [[True, True, False], [True, True, True]])
