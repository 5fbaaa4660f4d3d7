"""Statistics of the trade against closed forms and plain counting."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from seen_points import seen_points
from sionna_radar.accuracy.breakdown import DISTANCES_M, break_down, by_class, incidence_deg, variogram
from sionna_radar.accuracy.checkpoints import STEEPEST_DEG, checkpoint_test, checkpoints_wanted, slope_deg
from sionna_radar.accuracy.compare import MEANING, DemError, summarise
from sionna_radar.accuracy.illumination import Walls
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.scene.footprints import Box

NO_WALLS = Walls(buildings=(), foot_m=np.zeros((0, 2)))


def grid_of(rows: int, columns: int, spacing_m: float = 1.0) -> Grid:
    return Grid(west_m=0.0, south_m=0.0, spacing_m=spacing_m, columns=columns, rows=rows)


def flat(grid: Grid) -> Raster:
    return Raster(grid=grid, height_m=np.zeros(grid.shape))


def noise(grid: Grid, sigma_m: float = 0.2, bias_m: float = 0.0, seed: int = 1) -> Raster:
    return Raster(grid=grid, height_m=np.random.default_rng(seed).normal(bias_m, sigma_m, grid.shape))


# ------------------------------------------------------------------------------------------- percentiles


def test_linear_errors_of_a_normal_distribution() -> None:
    error = noise(grid_of(500, 500), sigma_m=0.3)
    stats = summarise(error, np.ones(error.grid.shape, dtype=bool))
    for name, quantile in (("le68_m", norm.ppf(0.5 + 0.6827 / 2)), ("le90_m", 1.645), ("le95_m", 1.960)):
        assert getattr(stats, name) == pytest.approx(0.3 * quantile, rel=0.01), name
    # The width that others call LE90 is twice as much where there is no bias.
    assert stats.p95_p5_m == pytest.approx(2 * stats.le90_m, rel=0.01)
    assert set(MEANING) <= set(DemError.__annotations__)


# ------------------------------------------------------------------------------------------ checkpoints


@pytest.mark.parametrize(
    ("km2", "wanted"), [(0.01, 30), (1000, 30), (1000.1, 40), (5000, 70), (10_000, 120), (1e6, 120)]
)
def test_how_many_checkpoints(km2: float, wanted: int) -> None:
    assert checkpoints_wanted(km2 * 1e6) == wanted


def test_the_checkpoints_rmse_is_that_of_the_dem() -> None:
    grid = grid_of(120, 150)
    error, everywhere = noise(grid, 0.2, 0.05), np.ones(grid.shape, dtype=bool)
    found = [checkpoint_test(error, flat(grid), everywhere, seed) for seed in range(60)]
    assert {test.count for test in found} == {30}
    # The mean square of 60 times 30 checkpoints, against that of all cells.
    assert np.mean([test.rms_m**2 for test in found]) == pytest.approx(0.2**2 + 0.05**2, rel=0.1)
    assert all(test.class_cm == int(np.ceil(100 * test.rms_m)) for test in found)
    assert all(f"{test.class_cm}-cm RMSE_V" in test.statement for test in found)
    assert len({test.rms_m for test in found}) == 60
    # 30 places in 120 x 150 m that keep a tenth of the diagonal between them, or nearly so.
    assert min(test.spacing_m for test in found) > 0.06 * np.hypot(120, 150)


def test_checkpoints_lie_on_lit_even_ground() -> None:
    grid = grid_of(80, 80)
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    truth = Raster(grid=grid, height_m=np.where(x > 40, 0.5 * (x - 40), 0.0))
    lit = y > 20
    error = Raster(grid=grid, height_m=np.where(x >= 40, 5.0, np.where(lit, 0.1, 9.0)))
    test = checkpoint_test(error, truth, lit, seed=3)
    assert (test.even, test.class_cm) == (True, 10)
    assert test.greatest_m == pytest.approx(0.1)
    steep = checkpoint_test(error, Raster(grid=grid, height_m=0.5 * x), lit, seed=3)
    assert not steep.even
    assert "any slope" in steep.statement
    assert pytest.approx(5.7106, abs=1e-4) == STEEPEST_DEG


def test_too_few_cells_are_no_test() -> None:
    grid = grid_of(5, 5)
    few = checkpoint_test(noise(grid), flat(grid), np.ones(grid.shape, dtype=bool), seed=0)
    none = checkpoint_test(noise(grid), flat(grid), np.zeros(grid.shape, dtype=bool), seed=0)
    assert (few.count, few.class_cm, none.count, none.class_cm) == (25, None, 0, None)
    assert np.isnan(none.rms_m)
    assert few.statement.startswith("not tested")
    one = grid_of(1, 40)  # a row of cells, one beside the other
    assert checkpoint_test(noise(one), flat(one), np.ones(one.shape, dtype=bool), seed=0).count == 30


def test_no_class_is_stated_where_walls_or_plants_hold_a_fifth_of_the_map() -> None:
    grid = grid_of(80, 80)
    lit = np.ones(grid.shape, dtype=bool)
    tested, hidden = (
        checkpoint_test(noise(grid), flat(grid), lit, 3, {"plants": 0.05, "walls": share}) for share in (0.19, 0.31)
    )
    assert tested.where in tested.statement
    assert (tested.class_cm, hidden.class_cm) == (int(np.ceil(100 * tested.rms_m)), None)
    assert hidden.statement.startswith("not tested")
    assert "walls hold 31% of the cells" in hidden.statement
    assert "plants" not in hidden.statement


# ---------------------------------------------------------------------------------------------- classes


def test_classes_are_those_of_plain_counting() -> None:
    rng = np.random.default_rng(2)
    error, value = rng.normal(size=1000), rng.choice([0.0, 4.9, 5.0, 30.0, np.nan, np.inf], 1000)
    classes = by_class(error, value, (0.0, 5.0, 10.0, 20.0, np.inf))
    assert [(c.low, c.high) for c in classes] == [(0.0, 5.0), (5.0, 10.0), (20.0, np.inf)]
    for found, own in zip(classes, (value < 5, value == 5, value >= 20), strict=True):
        assert found.count == own.sum()
        assert found.rms_m == pytest.approx(np.sqrt(np.mean(error[own] ** 2)))
        assert found.mean_m == pytest.approx(error[own].mean())


def test_slope_and_incidence_of_a_plane() -> None:
    grid = grid_of(20, 20, 2.0)
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    plane = Raster(grid=grid, height_m=0.3 * x - 0.4 * y)
    inner = np.zeros(grid.shape, dtype=bool)
    inner[1:-1, 1:-1] = True
    np.testing.assert_allclose(slope_deg(plane)[inner], np.rad2deg(np.arctan(0.5)))
    assert np.isnan(slope_deg(plane)[~inner]).all()
    # Seen along its normal from far away; and from straight above.
    normal = np.array([-0.3, 0.4, 1.0]) / np.linalg.norm([-0.3, 0.4, 1.0])
    centre = np.array([[20.0, 20.0, 0.3 * 20 - 0.4 * 20]])
    along = incidence_deg(plane, seen_points(centre, tuple(centre[0] + 1e6 * normal)), inner)
    above = incidence_deg(plane, seen_points(centre, (20.0, 20.0, 1e6)), inner)
    np.testing.assert_allclose(along, 0.0, atol=0.01)
    np.testing.assert_allclose(above, np.rad2deg(np.arctan(0.5)), atol=0.01)
    assert np.isnan(incidence_deg(plane, seen_points(np.zeros((0, 3)), (0.0, 0.0, 1.0)), inner)).all()


def test_errors_by_distance_from_walls() -> None:
    grid = grid_of(60, 60)
    box = Box(position_m=(30.0, 30.0), size_m=(10.0, 10.0, 8.0))
    walls = Walls(buildings=(box,), foot_m=np.zeros((0, 2)))
    beyond = np.maximum(np.abs(grid.centres_m[:, 0] - 30), np.abs(grid.centres_m[:, 1] - 30)) - 5
    distance = walls.distance_m(grid.centres_m, 20.0)
    beside = np.abs(grid.centres_m[:, 1] - 30) <= 5
    reached = beside & (np.abs(beyond) <= 20)
    np.testing.assert_allclose(distance[reached], np.abs(beyond)[reached])
    assert np.isinf(distance[beside & (beyond > 20)]).all()
    # The same by points along its foot.
    foot = np.array([[25 + t, y] for t in np.linspace(0, 10, 2001) for y in (25.0, 35.0)])
    foot = np.vstack([foot, foot[:, ::-1]])
    np.testing.assert_allclose(Walls(buildings=(), foot_m=foot).distance_m(grid.centres_m, 20.0), distance, atol=0.01)
    error = Raster(grid=grid, height_m=np.where(distance < 2, 1.0, 0.1).reshape(grid.shape))
    points = seen_points(np.column_stack([grid.centres_m, np.zeros(3600)])[::7], (30.0, 30.0, 50.0))
    found = break_down(error, flat(grid), np.ones(grid.shape, dtype=bool), points, walls, seed=0)
    assert found.by_wall_distance is not None
    assert [c.rms_m for c in found.by_wall_distance] == pytest.approx([1.0, 1.0, 0.1, 0.1, 0.1, 0.1])
    assert sum(c.count for c in found.by_wall_distance) == 3600
    assert (found.by_wall_distance[-1].low, found.by_wall_distance[-1].high) == DISTANCES_M[-2:]
    bare = break_down(error, flat(grid), np.ones(grid.shape, dtype=bool), points, NO_WALLS, seed=0)
    assert bare.by_wall_distance is None
    assert replace(bare, by_wall_distance=found.by_wall_distance) == found


# ------------------------------------------------------------------------------------------- variogram


def exponential_field(size: int, length: float, sigma: float, seed: int) -> np.ndarray:
    """A periodic Gaussian field of covariance sigma^2 exp(-h / length), from its spectrum."""
    lag = np.minimum(np.arange(size), size - np.arange(size))
    spectrum = np.fft.fft2(sigma**2 * np.exp(-np.hypot(*np.meshgrid(lag, lag)) / length)).real
    white = np.fft.fft2(np.random.default_rng(seed).normal(size=(size, size)))
    return np.fft.ifft2(np.sqrt(np.maximum(spectrum, 0)) * white).real


def test_variogram_of_a_field_with_a_known_one() -> None:
    size, length, spacing = 512, 6.0, 0.5
    grid = grid_of(size, size, spacing)
    error = Raster(grid=grid, height_m=exponential_field(size, length, 0.3, 5))
    seen = np.random.default_rng(0).random(grid.shape) < 0.7  # holes change nothing but the number of pairs
    found = variogram(error, seen, seed=1)
    assert found is not None
    for lag in found.lags:
        theory = 0.3**2 * (1 - np.exp(-lag.lag_m / spacing / length))
        # 2000 pairs of a field of 0.3 m have a standard error of 3 %, and fewer are independent.
        assert lag.semivariance_m2 == pytest.approx(theory, rel=0.2), lag
        assert lag.robust_m2 == pytest.approx(theory, rel=0.25), lag
    assert found.correlation_length_m == pytest.approx(length * spacing, rel=0.25)
    assert found == variogram(error, seen, seed=1)


def test_variogram_of_little() -> None:
    grid = grid_of(40, 40)
    assert variogram(noise(grid), np.zeros(grid.shape, dtype=bool), seed=0) is None
    white = variogram(noise(grid), np.ones(grid.shape, dtype=bool), seed=0)
    assert white is not None
    assert white.correlation_length_m is None  # neighbours differ as much as all others
