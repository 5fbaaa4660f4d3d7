"""The randomisation test: its rate of false alarms on heavy-tailed errors, and what it finds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from sionna_radar.accuracy.randomisation import compare_speckle
from sionna_radar.foundation.raster import Grid, Raster

GRID = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=96, rows=72)


def errors(random, shift_m=0.0):
    """A DEM's errors: smooth speckle, and walls drawn to either side now and then."""
    speckle = gaussian_filter(random.standard_normal(GRID.shape), 1.5) * 0.3
    wall = np.zeros(GRID.shape)
    wall[30:34, 10:60] = 8.0 * (gaussian_filter(random.standard_normal((4, 50)), 1.5) > 0.1)
    return Raster(grid=GRID, height_m=speckle + wall + shift_m)


def outcome(seed, shift_m=0.0):
    random = np.random.default_rng(seed)
    return compare_speckle(
        (errors(random), errors(random)), (errors(random, shift_m), errors(random, shift_m)), correlation_m=4.0
    )


@pytest.mark.study
def test_false_alarms_come_as_often_as_stated():
    """Of 400 pairs of equal engines 5 % fall below 0.05: 20 with a standard deviation of 4.4."""
    below = sum(outcome(seed).probability <= 0.05 for seed in range(400))
    assert 6 <= below <= 34


def test_yardstick_is_the_same_within_and_across_equal_engines():
    outcomes = [outcome(seed) for seed in range(40)]
    cross, speckle = (np.mean([getattr(o, f"{name}_rms_m") ** 2 for o in outcomes]) for name in ("cross", "speckle"))
    assert cross == pytest.approx(speckle, rel=0.1)


def test_a_shift_below_the_speckle_is_found():
    assert all(outcome(seed, shift_m=0.05).probability < 1e-3 for seed in range(10))


def test_too_few_tiles_cannot_tell():
    random = np.random.default_rng(0)
    pairs = [(errors(random), errors(random)) for _ in range(2)]
    coarse = compare_speckle(*pairs, correlation_m=20.0)
    assert coarse.tiles == 4
    assert not coarse.can_reject(1e-3)
    assert coarse.can_reject(0.05)


def test_few_tiles_raise_no_more_false_alarms_than_stated_and_find_what_is_large():
    """Two tiles: by the ratio of RMS alone 4 % of equal engines differ by a quarter more than their seeds do."""
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=18, rows=10)

    def few(seed: int, shift_m: float) -> float:
        random = np.random.default_rng(seed)
        height = [gaussian_filter(random.standard_normal(grid.shape), 1.5) for _ in range(4)]
        one, again, *others = (Raster(grid=grid, height_m=h) for h in height)
        other, other_again = (replace(dem, height_m=dem.height_m + shift_m) for dem in others)
        return compare_speckle((one, again), (other, other_again), correlation_m=4.0).gaussian_probability

    assert min(few(seed, 0.0) for seed in range(200)) > 1e-3
    assert all(few(seed, 3.0) < 1e-2 for seed in range(20))


def test_without_common_cells_nothing_is_known():
    random = np.random.default_rng(0)
    empty = Raster(grid=GRID, height_m=np.full(GRID.shape, np.nan))
    assert np.isnan(compare_speckle((errors(random), empty), (empty, empty), correlation_m=4.0).probability)
