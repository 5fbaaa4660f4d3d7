"""The statistics of an elevation error against values worked out by hand."""

import numpy as np
import pytest

from sionna_radar.accuracy.compare import difference, summarise
from sionna_radar.foundation.raster import Grid, Raster

GRID = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=4, rows=3)


def raster(values) -> Raster:
    return Raster(grid=GRID, height_m=np.array(values, dtype=float).reshape(GRID.shape))


def test_statistics_by_hand():
    nan = np.nan
    error = raster([-3, -1, -1, 0, 0, 1, 1, 1, 2, 10, nan, nan])
    result = summarise(error, np.ones(GRID.shape, dtype=bool))
    assert result.count == 10
    assert result.coverage == pytest.approx(10 / 12)
    assert (result.min_m, result.max_m) == (-3, 10)
    assert result.mean_m == pytest.approx(1.0)
    assert result.rms_m == pytest.approx(np.sqrt(118 / 10))
    assert result.std_m == pytest.approx(np.sqrt(118 / 10 - 1))
    # Median 0.5; distances from it sorted: .5 .5 .5 .5 .5 1.5 1.5 1.5 3.5 9.5, their median 1.
    assert result.nmad_m == pytest.approx(1.4826)
    # |error| sorted: 0 0 1 1 1 1 1 2 3 10; the ninth decile lies a tenth of the way from 3 to 10.
    assert result.le90_m == pytest.approx(3.7)


def test_coverage_counts_the_lit_cells_alone():
    error = raster([0, 0, 0, 0] + [np.nan] * 8)
    lit = np.zeros(GRID.shape, dtype=bool)
    lit.ravel()[[2, 3, 4, 5, 6]] = True
    result = summarise(error, lit)
    assert result.count == 4
    assert result.coverage == pytest.approx(2 / 5)
    assert summarise(error, np.zeros(GRID.shape, dtype=bool)).coverage == 0.0


def test_an_empty_error_has_no_statistics():
    result = summarise(raster([np.nan] * 12), np.ones(GRID.shape, dtype=bool))
    assert (result.count, result.coverage) == (0, 0.0)
    assert all(np.isnan(getattr(result, f"{name}_m")) for name in ("min", "max", "std", "mean", "rms", "nmad", "le90"))


def test_the_error_is_dem_minus_truth_and_empty_where_either_is():
    dem, truth = raster([5.0] * 12), raster([3.5] * 12)
    dem.height_m[0, 0] = truth.height_m[2, 1] = np.nan
    error = difference(dem, truth)
    assert np.isnan(error.height_m[0, 0])
    assert np.isnan(error.height_m[2, 1])
    np.testing.assert_array_equal(error.height_m[error.filled], 1.5)


def test_rasters_on_different_grids_are_not_compared():
    other = Grid(west_m=0.5, south_m=0.0, spacing_m=1.0, columns=4, rows=3)
    with pytest.raises(ValueError, match="different grids"):
        difference(raster([0.0] * 12), Raster(grid=other, height_m=np.zeros(other.shape)))
