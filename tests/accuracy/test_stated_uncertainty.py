"""Stated uncertainties held against errors whose distribution is known."""

import numpy as np
import pytest

from seen_points import seen_points
from sionna_radar.accuracy.uncertainty import check_uncertainty
from sionna_radar.foundation.raster import Grid, Raster

GRID = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=120, rows=100)
LIT = np.ones(GRID.shape, dtype=bool)


def point_at(x, y):
    return seen_points([[x, y, 0.0]], (x, y, 50.0))


class Independent:
    """Cells whose errors are independent, of one standard deviation."""

    def sigma_m(self, grid, wanted):
        return np.where(wanted, 0.2, np.nan)

    def mean_sigma_m(self, place_m, window_m):
        return 0.2 / np.sqrt(len(place_m))


@pytest.fixture(scope="module")
def check():
    error = Raster(grid=GRID, height_m=0.2 * np.random.default_rng(7).standard_normal(GRID.shape))
    sigma = Raster(grid=GRID, height_m=np.full(GRID.shape, 0.2))
    truth = Raster(grid=GRID, height_m=np.broadcast_to(0.2 * GRID.x_m, GRID.shape).copy())
    return check_uncertainty(error, sigma, truth, LIT, point_at(50.0, 50.0), Independent())


def test_normal_errors_lie_in_their_intervals(check):
    assert list(check.cells.coverage.values()) == pytest.approx([0.5, 0.68, 0.9, 0.95], abs=0.015)
    assert check.cells.nmad_z == pytest.approx(1.0, abs=0.03)
    assert check.cells.rms_z == pytest.approx(1.0, abs=0.03)
    assert check.cells.sigma_rms_m == pytest.approx(0.2)


def test_classes_divide_the_cells(check):
    # All cells but those at the border have the slope of the ramp, 11 deg.
    assert [(c.low, c.calibration.count) for c in check.by_slope] == [(10.0, 118 * 98)]
    assert sum(c.calibration.count for c in check.by_echo_distance) == GRID.rows * GRID.columns
    assert check.by_echo_distance[0].calibration.count == 1


def test_means_over_windows_scatter_as_stated(check):
    assert [(m.window_m, m.count) for m in check.means] == [(10.0, 24), (30.0, 12)]
    assert [m.ratio for m in check.means] == pytest.approx([1.0, 1.0], abs=0.25)


def test_too_small_a_sigma_shows():
    error = Raster(grid=GRID, height_m=0.2 * np.random.default_rng(7).standard_normal(GRID.shape))
    sigma = Raster(grid=GRID, height_m=np.full(GRID.shape, 0.1))
    check = check_uncertainty(error, sigma, error, LIT, point_at(50.0, 50.0), None)
    assert check.cells.nmad_z == pytest.approx(2.0, abs=0.06)
    assert check.cells.coverage["90"] < 0.62
    assert check.means == ()
    assert check_uncertainty(error, sigma, error, ~LIT, point_at(50.0, 50.0), None) is None
