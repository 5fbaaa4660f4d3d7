"""Stated uncertainties against plain formulas, and against the errors of many drawn terrains."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.inference.echo.likelihood import Linearised
from sionna_radar.inference.terrain.covariance import Covariance, FittedCovariance
from sionna_radar.inference.terrain.covariance_fit import repeated
from sionna_radar.inference.terrain.heights import Heights
from sionna_radar.inference.terrain.kriging import Kriging
from sionna_radar.inference.terrain.local_relief import UNIFORM
from sionna_radar.inference.terrain.uncertainty import (
    Information,
    TiledUncertainty,
    TileUncertainty,
    information_of,
)
from sionna_radar.mapping.linear.gridding import Interpolated
from sionna_radar.mapping.linear.linear import LinearUncertainty
from sionna_radar.mapping.mapper import Estimate

GRID = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=12, rows=10)
TERRAIN = Covariance(1.5, 8.0, 2.0)
EVERYWHERE = (-np.inf, np.inf, -np.inf, np.inf)


def apart(a, b):
    return np.linalg.norm(a[:, None] - b[None], axis=2)


@pytest.fixture(scope="module")
def heights():
    rng = np.random.default_rng(4)
    place = rng.uniform(-1, 12, (40, 2))
    return Heights.at_places(place, np.zeros(40), rng.uniform(0.1, 0.3, 40))


@pytest.fixture(scope="module")
def drawn(heights):
    """Measured heights and true ones, of 400 terrains."""
    rng = np.random.default_rng(5)
    place = np.concatenate([heights.place_m, GRID.centres_m])
    root = np.linalg.cholesky(TERRAIN.at(apart(place, place)) + 1e-8 * np.eye(len(place)))
    true = root @ rng.standard_normal((len(place), 400))
    measured = true[: len(heights)] + heights.sigma_m[:, None] * rng.standard_normal((len(heights), 400))
    return measured, true[len(heights) :]


@pytest.mark.parametrize(("variance_m2", "length_m"), [(1e-7, 30.0), (1e-7, 3.0), (2.0, 8.0)])
def test_the_trend_is_known_as_well_as_the_echoes_tell(heights, variance_m2, length_m):
    """As by universal kriging: over level ground it is all that is unknown, over hills next to nothing."""
    terrain, cell = Covariance(1.5, length_m, variance_m2), GRID.centres_m
    total = terrain.at(apart(heights.place_m, heights.place_m)) + np.diag(heights.sigma_m**2)
    between, design = terrain.at(apart(heights.place_m, cell)), np.column_stack([np.ones(40), heights.place_m])
    solved = np.linalg.solve(total, np.column_stack([between, design]))
    simple = variance_m2 - np.sum(between * solved[:, : len(cell)], axis=0)
    rest = np.column_stack([np.ones(len(cell)), cell]).T - design.T @ solved[:, : len(cell)]
    universal = simple + np.sum(rest * np.linalg.solve(design.T @ solved[:, len(cell) :], rest), axis=0)
    found = Kriging(terrain, heights, 1.0).sigma_m(GRID, np.ones(GRID.shape, dtype=bool)).ravel()
    # Beyond the last echoes of hills the trend is known a little less well than the noise alone says.
    np.testing.assert_allclose(found, np.sqrt(universal), rtol=0.03 if variance_m2 < 1e-3 else 0.08)
    assert np.median(np.abs(found / np.sqrt(universal) - 1)) < 0.005
    if variance_m2 < 1e-3:
        assert found.min() > 20 * np.sqrt(simple.max())
        # The trend that is taken from the heights scatters as stated.
        rng = np.random.default_rng(8)
        drawn = heights.sigma_m[:, None] * rng.standard_normal((40, 4000))
        weighted = np.linalg.lstsq(design / heights.sigma_m[:, None], drawn / heights.sigma_m[:, None], rcond=None)[0]
        scatter = np.std(np.column_stack([np.ones(len(cell)), cell]) @ weighted, axis=1)
        np.testing.assert_allclose(found, scatter, rtol=0.06)
        window = Kriging(terrain, heights, 1.0).mean_sigma_m(cell)
        middle = float(np.std(np.array([1.0, *cell.mean(axis=0)]) @ weighted))
        assert window == pytest.approx(middle, rel=0.06)


@pytest.mark.parametrize("smoothness", [0.5, 0.8, 2.5, np.inf])
def test_means_over_footprints_have_the_smoothed_covariance(smoothness):
    covariance = Covariance(smoothness, 6.0, 3.0)
    node, weight = np.polynomial.hermite_e.hermegauss(40)
    weight = weight / weight.sum()
    spread = 2.0
    # Two footprints: the difference of two places in them has twice the variance.
    x, y = np.meshgrid(np.sqrt(2) * spread * node, np.sqrt(2) * spread * node)
    for distance in (0.5, 4.0, 15.0):
        expected = np.sum(np.outer(weight, weight) * covariance.at(np.hypot(distance + x, y)))
        assert covariance.at(np.array([distance]), spread)[0] == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("smoothness", [0.3, 0.45, 1.5])
def test_a_small_footprint_hardly_smooths_rough_terrain(smoothness):
    covariance = Covariance(smoothness, 6.0, 3.0)
    distance = np.array([0.5, 4.0, 15.0])
    np.testing.assert_allclose(covariance.at(distance, 1e-3), covariance.at(distance), atol=1e-5)


@pytest.mark.parametrize("microrelief_m", [0.0, 0.4])
@pytest.mark.parametrize("smoothness", [0.5, 1.5, np.inf])
def test_the_power_of_all_waves_is_the_variance(smoothness, microrelief_m):
    covariance = Covariance(smoothness, 6.0, 3.0, microrelief_m)
    k = np.geomspace(1e-5, 1e4, 20_000)
    total = np.trapezoid(covariance.power(k) * 2 * np.pi * k, k) / (2 * np.pi) ** 2
    assert total == pytest.approx(covariance.at(np.zeros(1))[0], rel=2e-3)


def test_the_kriging_variance_is_the_plain_formulas_and_that_of_errors(heights, drawn):
    kriging = Kriging(TERRAIN, heights, 1.0)
    sigma = kriging.sigma_m(GRID, np.ones(GRID.shape, dtype=bool))
    K = TERRAIN.at(apart(heights.place_m, heights.place_m)) + np.diag(heights.sigma_m**2)
    k = TERRAIN.at(apart(heights.place_m, GRID.centres_m))
    weight = np.linalg.solve(K, k)
    expected = np.sqrt(2.0 - np.sum(k * weight, axis=0)).reshape(GRID.shape)
    np.testing.assert_allclose(sigma, expected, rtol=1e-3)
    measured, true = drawn
    z = (weight.T @ measured - true) / sigma.reshape(-1, 1)
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.03)


def test_intervals_hold_over_smooth_hills_with_microrelief_only_if_it_is_stated():
    """Heights are means over footprints of 0.8 m; their ground is drawn on cells of 0.4 m."""
    stated = Covariance(np.inf, 12.0, 2.0, microrelief_m=0.08)
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=0.4, columns=50, rows=50)
    rng = np.random.default_rng(6)
    root = np.linalg.cholesky(stated.at(apart(grid.centres_m, grid.centres_m)) + 1e-8 * np.eye(2500))
    place = rng.uniform(4, 16, (60, 2))
    axes = np.broadcast_to(0.8 * np.eye(2), (60, 2, 2))
    heights = replace(Heights.at_places(place, np.zeros(60), np.full(60, 0.05)), footprint_m=axes)
    middle = slice(15, 35)
    seen = grid.cut(middle, middle)
    true = root @ rng.standard_normal((2500, 60))
    measured = heights.weights(grid) @ true + 0.05 * rng.standard_normal((60, 60))
    inside = np.arange(2500).reshape(grid.shape)[middle, middle].ravel()
    share = {}
    for name, covariance in (("stated", stated), ("not", stated.landforms)):
        sigma = Kriging(covariance, heights, 1.0).sigma_m(seen, np.ones(seen.shape, dtype=bool)).ravel()
        spread = 0.8
        K = covariance.at(apart(place, place), spread) + 0.05**2 * np.eye(60)
        weight = np.linalg.solve(K, covariance.at(apart(place, seen.centres_m), spread / np.sqrt(2)))
        z = (weight.T @ measured - true[inside]) / sigma[:, None]
        share[name] = np.mean(np.abs(z) < 1.96)
    assert share["stated"] == pytest.approx(0.95, abs=0.02)
    assert share["not"] < 0.8


def test_means_over_windows_know_the_covariance_between_cells(heights, drawn):
    kriging = Kriging(TERRAIN, heights, 1.0)
    stated = kriging.mean_sigma_m(GRID.centres_m)
    K = TERRAIN.at(apart(heights.place_m, heights.place_m)) + np.diag(heights.sigma_m**2)
    weight = np.linalg.solve(K, TERRAIN.at(apart(heights.place_m, GRID.centres_m)))
    measured, true = drawn
    error = (weight.T @ measured - true).mean(axis=0)
    assert stated == pytest.approx(error.std(), rel=0.1)
    independent = kriging.sigma_m(GRID, np.ones(GRID.shape, dtype=bool)).mean() / np.sqrt(GRID.rows * GRID.columns)
    assert stated > 2 * independent


def test_a_linear_interpolation_errs_as_it_says(heights, drawn):
    triangles = Delaunay(heights.place_m)
    cell = np.flatnonzero(triangles.find_simplex(GRID.centres_m) >= 0)
    corner = triangles.simplices[triangles.find_simplex(GRID.centres_m)[cell]]
    ones = np.concatenate([heights.place_m[corner], np.ones((*corner.shape, 1))], axis=2).transpose(0, 2, 1)
    share = np.linalg.solve(ones, np.column_stack([GRID.centres_m[cell], np.ones(len(cell))])[..., None])[..., 0]
    dem = Raster(grid=GRID, height_m=np.zeros(GRID.shape))
    linear = LinearUncertainty(Interpolated(dem, cell, corner, share), heights, FittedCovariance(TERRAIN, 1.0), UNIFORM)
    sigma = linear.sigma_m(GRID, np.ones(GRID.shape, dtype=bool)).ravel()[cell]
    measured, true = drawn
    error = np.einsum("ck,ckt->ct", share, measured[corner]) - true[cell]
    np.testing.assert_allclose(sigma, error.std(axis=1), rtol=0.2)
    assert np.mean((error / sigma[:, None]) ** 2) == pytest.approx(1.0, abs=0.05)
    assert np.isnan(linear.mean_sigma_m(GRID.centres_m, 10.0))


def test_pairs_of_heights_share_noise_as_all_of_them_do(heights):
    shared = replace(heights, reach=np.linspace(0.0, 3.0, len(heights)))
    one, other = np.meshgrid(np.arange(40), np.arange(40), indexing="ij")
    sigma = np.maximum(shared.sigma_m, 1e-3)
    expected = 1.5 * np.outer(sigma, sigma) * repeated(shared.order, shared.reach)
    np.testing.assert_allclose(shared.noise_m2(one, other, 1.5), expected)


def test_what_is_left_is_what_neither_the_terrain_nor_whole_echoes_tell():
    wave = np.linspace(0.1, 2.0, 50)
    weight, means, echoes = wave * 0.1, np.full(50, 0.2), np.geomspace(0.1, 5.0, 50)
    information = Information(wave, weight, means, echoes)
    rough, smooth = Covariance(0.5, 20.0, 3.0), Covariance(2.5, 9.0, 2.0)
    taken_for, fitted = FittedCovariance(rough, 0.8), FittedCovariance(rough, 1.1)

    def left(terrain, whole):
        told = means / terrain.noise_factor
        return weight @ (1 / (1 / terrain.covariance.power(wave) + (np.maximum(told, echoes) if whole else told)))

    taken, expected = left(taken_for, whole=False), left(fitted, whole=True)
    known, here = (taken_for, fitted, None), np.zeros((1, 2))
    assert information.posterior_variance_m2(np.array([taken]), *known, here) == pytest.approx(expected)
    assert information.posterior_variance_m2(np.array([taken / 2]), *known, here) == pytest.approx(expected / 2)
    # Far from all echoes it changes by no more than where they lie.
    assert information.posterior_variance_m2(np.array([100 * taken]), *known, here) == pytest.approx(
        99 * taken + expected
    )
    # A wide window averages short waves away, of which the smooth terrain has none.
    known = taken_for, FittedCovariance(smooth, 0.9), None
    narrow, wide = (information.posterior_variance_m2(np.array([1e-9]), *known, here, w) for w in (0.0, 30.0))
    assert wide > 2 * narrow


def test_the_mean_over_a_wide_window_is_that_of_all_of_its_cells():
    """Of rough terrain, many more cells than squares that stand for them; against the covariance of all of them."""
    rng = np.random.default_rng(8)
    rough, grid = Covariance(0.5, 15.0, 1.0), Grid(west_m=0.0, south_m=0.0, spacing_m=0.8, columns=40, rows=36)
    heights = Heights.at_places(rng.uniform(-2, 38, (150, 2)), np.zeros(150), np.full(150, 0.05))
    place = grid.centres_m
    whole = rough.at(apart(heights.place_m, heights.place_m)) + np.diag(heights.variance_m2(1.0))
    mean = np.array([rough.at(apart(one[None], place)).mean() for one in heights.place_m])
    before = np.mean([rough.at(apart(one[None], place)).mean() for one in place])
    expected = np.sqrt(before - mean @ np.linalg.solve(whole, mean))
    assert Kriging(rough, heights, 1.0).mean_sigma_m(place) == pytest.approx(expected, rel=0.05)


def test_echoes_tell_what_the_score_of_the_median_one_does():
    """Against the variance of scores with plain matrices; an echo that seems to tell most counts as others do."""
    rng = np.random.default_rng(6)
    place, rows, looks = rng.uniform(0, 4, (3, 7, 2)), 5, 0.514
    factor = rng.standard_normal((3 * rows, 7)).astype(np.float32)
    factor[:rows] *= np.array([3.0, -3.0, 3.0, -3.0, 3.0])[:, None]
    heights = replace(
        Heights.at_places(place.mean(axis=1), np.zeros(3), np.full(3, 0.2)),
        footprint_m=np.broadcast_to(np.eye(2), (3, 2, 2)),
    )
    weight = rng.uniform(0.2, 1.0, 3 * rows)
    first = rows * np.arange(3)
    nothing = np.zeros((3, 7)), factor, first, first + rows, np.zeros(3 * rows), weight
    information = information_of(heights, lambda _: Linearised(place, *nothing), looks)
    alike = (np.eye(rows) + (1 / looks - 1) / 2 * (np.eye(rows, k=1) + np.eye(rows, k=-1))) * looks
    density = 3 / np.prod(np.maximum(np.ptp(heights.place_m, axis=0), 1.0))
    for number in (0, 60, 150):
        length, heading = np.geomspace(250.0, 0.5, 26)[number // 8], (number % 8 + 0.5) * np.pi / 8
        wave = 2 * np.pi / length * np.array([np.cos(heading), np.sin(heading)])
        each = []
        for pulse in range(3):
            own = slice(pulse * rows, (pulse + 1) * rows)
            e = factor[own] @ np.exp(1j * (place[pulse] - heights.place_m[pulse]) @ wave)
            spread = np.sqrt(weight[own]) * e
            each.append((np.sum(np.abs(e) ** 2), np.real(spread.conj() @ alike @ spread)))
        power, noise = np.median(each, axis=0)
        assert information.by_echoes[number] == pytest.approx(density * power**2 / noise, rel=1e-5)


def test_whole_echoes_tell_as_less_noise_would_beyond_the_last_of_them_too(heights):
    """Told four times as much of all waves, heights are known as those of half the errors, far and near.

    But for their trend, which is that of mean ranges.
    """
    near = heights.rows(heights.place_m[:, 0] < 6)
    means = information_of(near)
    whole = replace(means, by_echoes=4 * means.by_means)
    told = TileUncertainty.of(EVERYWHERE, Kriging(TERRAIN, near, 1.0), whole, window_heights=40)
    wanted = np.ones(GRID.shape, dtype=bool)
    halved = Kriging(TERRAIN, replace(near, sigma_m=near.sigma_m / 2), 1.0).sigma_m(GRID, wanted)
    np.testing.assert_allclose(told.kriging.sigma_m(GRID, wanted), halved, rtol=0.006)
    assert means.gain(1.0) == 1.0
    assert whole.gain(2.0) == pytest.approx(8.0)


def test_a_window_over_several_tiles_is_known_from_the_echoes_of_all(heights):
    bounds = ((-np.inf, 6.0, -np.inf, np.inf), (6.0, np.inf, -np.inf, np.inf))
    kriging, information, x = Kriging(TERRAIN, heights, 1.0), information_of(heights), heights.place_m[:, 0]
    both = TiledUncertainty(
        tuple(
            TileUncertainty(own, replace(kriging, heights=heights.rows(near)), information, 1.0)
            for own, near in zip(bounds, (x < 7, x > 5), strict=True)
        )
    )
    whole = kriging.mean_sigma_m(GRID.centres_m)
    assert both.mean_sigma_m(GRID.centres_m, 11.0) == pytest.approx(whole, rel=1e-9)
    assert both.tiles[0].kriging.mean_sigma_m(GRID.centres_m) > 1.2 * whole


def test_tiles_share_the_map_and_badly_known_cells_are_left_out(heights):
    information, bounds = information_of(heights), ((-np.inf, 6.0, -np.inf, np.inf), (6.0, np.inf, -np.inf, np.inf))
    west, east = (
        TileUncertainty(own, kriging, information, kriging.noise_factor)
        for own, kriging in zip(bounds, (Kriging(TERRAIN, heights, 1.0), Kriging(TERRAIN, heights, 100.0)), strict=True)
    )
    one = west.kriging.sigma_m(GRID, np.ones(GRID.shape, dtype=bool))
    np.testing.assert_allclose(
        west.posterior_sigma_m(one.ravel(), GRID.centres_m), one.ravel()
    )  # one terrain and mean ranges only: the kriging variance
    both = TiledUncertainty((west, east))
    wanted = np.ones(GRID.shape, dtype=bool)
    wanted[0] = False
    sigma = both.sigma_m(GRID, wanted)
    assert np.isnan(sigma[0]).all()
    assert sigma[1:, :5].mean() < 0.7 * sigma[1:, 7:].mean()
    assert both.mean_sigma_m(np.full((4, 2), 9.0), 2.0) > both.mean_sigma_m(np.full((4, 2), 3.0), 2.0)
    dem = Raster(grid=GRID, height_m=np.where(wanted, 1.0, np.nan))
    known = Estimate.with_sigma(dem, both)
    least = float(np.median(sigma[1:]))
    kept = known.within_sigma(least)
    np.testing.assert_array_equal(kept.dem.filled, kept.sigma.filled)
    assert kept.dem.filled.sum() == (sigma <= least).sum()
    assert Estimate(dem=dem).within_sigma(0.0).dem is dem


def test_echoes_that_no_surface_explains_widen_what_is_said_within_their_footprints(heights):
    information = information_of(heights)
    known = TileUncertainty(EVERYWHERE, Kriging(TERRAIN, heights, 1.0), information, 1.0)
    pole = replace(known, outstanding=np.array([[6.0, 5.0, 2.0, 9.0], [6.0, 5.0, 1.0, 12.0]]))
    wanted = np.ones(GRID.shape, dtype=bool)
    before, after = (TiledUncertainty((tile,)).sigma_m(GRID, wanted).ravel() for tile in (known, pole))
    away = np.hypot(*(GRID.centres_m - [6.0, 5.0]).T)
    np.testing.assert_array_equal(after[away >= 2.0], before[away >= 2.0])
    ring = (away >= 1.0) & (away < 2.0)
    np.testing.assert_allclose(after[ring], np.hypot(before[ring], 9.0))
    np.testing.assert_allclose(after[away < 1.0], np.hypot(before[away < 1.0], 12.0))
