"""Local amplitudes of relief, against terrains that were drawn with known ones and plain solutions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.distance import cdist

import sionna_radar.inference.terrain.local_relief as local_relief_module
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.terrain import kriging
from sionna_radar.inference.terrain.covariance import Covariance, FittedCovariance
from sionna_radar.inference.terrain.covariance_fit import fit_covariance
from sionna_radar.inference.terrain.heights import Heights
from sionna_radar.inference.terrain.kriging import Kriging
from sionna_radar.inference.terrain.local_relief import (
    UNIFORM,
    DividedTables,
    LocalRelief,
    _cross_line_errors,
    _modes,
    consistent_mask,
    local_relief,
    low_relief_mask,
    misfit_between_lines,
)
from sionna_radar.inference.terrain.smoothing import TerrainModel, smooth_with
from sionna_radar.mapping.options import SMOOTH

WINDOW = SMOOTH.window_heights
TERRAIN = Covariance(0.8, 12.0, 0.3)
# Of noise.
SIGMA_M = 0.05
# Broken ground on the right, calm ground on the left; short waves are those up to some 12 m.
BROKEN = LocalRelief(0.0, -40.0, 12.0, np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 1.1, 1.1, 1.1, 1.1, 1.1, 1.1], (8, 1)))


def covariance(one, other, local, spread_m=0.0):
    """Plainly: the covariance of long waves, and of what is left, times both amplitudes."""
    away = cdist(one, other)
    long = sum(
        sign * TERRAIN.at(away, np.hypot(spread_m, np.sqrt(k) * local.cut_m)) for k, sign in ((1, 3), (2, -3), (3, 1))
    )
    return long + np.outer(local.at(one), local.at(other)) * (TERRAIN.at(away, spread_m) - long)


@pytest.fixture(scope="module")
def drawn():
    """Heights over a terrain of local relief, at random places, and the true ones at others."""
    rng = np.random.default_rng(4)
    place = np.column_stack([rng.uniform(0, 120, 900), rng.uniform(-40, 40, 900)])
    total = covariance(place, place, BROKEN)
    height = np.linalg.cholesky(total + 1e-9 * np.eye(900)) @ rng.standard_normal(900)
    heights = Heights.at_places(place[:600], height[:600] + SIGMA_M * rng.standard_normal(600), np.full(600, SIGMA_M))
    return heights, place[600:], height[600:]


def test_the_amplitude_of_drawn_relief_is_found(drawn):
    heights, _, _ = drawn
    found = local_relief(heights.above(np.zeros(3)), FittedCovariance(TERRAIN, 1.0), WINDOW)
    amplitude, x = found.at(heights.place_m), heights.place_m[:, 0]
    assert np.median(amplitude[x < 45]) == pytest.approx(1.0, rel=0.25)
    assert np.median(amplitude[x > 75]) == pytest.approx(np.exp(1.1), rel=0.25)


def test_over_stationary_ground_all_amplitudes_are_one():
    rng = np.random.default_rng(5)
    place = rng.uniform(0, 90, (500, 2))
    height = np.linalg.cholesky(TERRAIN.at(cdist(place, place)) + SIGMA_M**2 * np.eye(500)) @ rng.standard_normal(500)
    heights = Heights.at_places(place, height, np.full(500, SIGMA_M))
    assert local_relief(heights.above(np.zeros(3)), FittedCovariance(TERRAIN, 1.0), WINDOW) is None
    assert local_relief(heights.rows(np.arange(60)).above(np.zeros(3)), FittedCovariance(TERRAIN, 1.0), WINDOW) is None


def test_broken_and_calm_ground_err_as_they_say(drawn):
    """With one covariance for all, calm ground is stated too badly and broken ground too well."""
    heights, place, true = drawn
    learned = local_relief(heights.above(np.zeros(3)), FittedCovariance(TERRAIN, 1.0), WINDOW)
    total = covariance(heights.place_m, heights.place_m, learned) + SIGMA_M**2 * np.eye(len(heights))
    weight = np.linalg.solve(total, covariance(heights.place_m, place, learned))
    for local, bound in ((learned, (0.8, 1.25)), (None, (1.3, 4.0))):
        stated = Kriging(TERRAIN, heights, 1.0, local)._of_places(place)
        z = (weight.T @ heights.height_m - true) / stated
        broken = float(np.sqrt(np.mean(z[place[:, 0] > 75] ** 2)))
        assert bound[0] < broken < bound[1], broken


@pytest.mark.parametrize(("exact", "most"), [(1000, 1.001), (60, 40.0)])
def test_the_near_inverse_is_that_of_the_covariance_of_the_heights(drawn, monkeypatch, exact, most):
    """Gradients converge by the ratio of the eigenvalues of its product with the covariance."""
    monkeypatch.setattr(kriging, "EXACT", exact)
    heights, _, _ = drawn
    inverse = Kriging(TERRAIN, heights, 1.0, BROKEN).near_inverse()
    total = covariance(heights.place_m, heights.place_m, BROKEN) + SIGMA_M**2 * np.eye(len(heights))
    left = np.sort(np.linalg.eigvals(np.column_stack([inverse(column) for column in total])).real)
    alone = np.linalg.eigvalsh(total)
    assert left[-1] / left[0] < most < 1e-2 * alone[-1] / alone[0]
    assert left[0] < 1.001
    assert left[-1] > 0.999


def test_heights_that_a_smooth_terrain_makes_nearly_the_same_have_a_near_inverse():
    """Their covariance is indefinite by the rounding of its tables."""
    place = np.random.default_rng(3).uniform(0, 50, (1200, 2))
    heights = Heights.at_places(place, np.zeros(1200), np.zeros(1200))
    inverse = Kriging(Covariance(12.0, 20.0, 1e4), heights, 0.02).near_inverse()
    assert np.all(np.isfinite(inverse(np.ones(1200))))


def test_kriging_with_local_relief_is_the_plain_solution(drawn):
    heights = replace(drawn[0].rows(np.arange(150)), footprint_m=np.broadcast_to(0.8 * np.eye(2), (150, 2, 2)))
    place = np.array([[30.0, 3.0], [80.0, -5.0], [81.0, 20.0]])
    whole = covariance(heights.place_m, heights.place_m, BROKEN, 0.8) + SIGMA_M**2 * np.eye(150)
    to_place = covariance(heights.place_m, place, BROKEN, 0.8 / np.sqrt(2))
    before = np.diag(covariance(place, place, BROKEN))
    expected = np.sqrt(before - np.einsum("ij,ij->j", to_place, np.linalg.solve(whole, to_place)))
    stated = np.array([Kriging(TERRAIN, heights, 1.0, BROKEN)._of_places(one[None])[0] for one in place])
    np.testing.assert_allclose(stated, expected, rtol=5e-3)


def test_the_surface_is_the_plain_solution(drawn):
    heights = drawn[0]
    grid = Grid(west_m=0.0, south_m=-40.0, spacing_m=0.5, columns=241, rows=161)
    found = smooth_with(heights, grid, np.zeros(3), FittedCovariance(TERRAIN, 1.0), local=BROKEN).surface
    place = np.array([[30.0, 3.0], [61.0, 4.0], [90.0, -12.0]])
    total = covariance(heights.place_m, heights.place_m, BROKEN) + SIGMA_M**2 * np.eye(len(heights))
    expected = covariance(place, heights.place_m, BROKEN) @ np.linalg.solve(total, heights.height_m)
    np.testing.assert_allclose(found.at(*place.T), expected, atol=0.03)


def test_colouring_and_its_adjoint_are_transposes():
    rng = np.random.default_rng(6)
    model = TerrainModel(
        Grid(west_m=0.0, south_m=-40.0, spacing_m=2.0, columns=64, rows=40), np.zeros(3), TERRAIN, BROKEN
    )
    white, field = rng.standard_normal(2 * 64 * 40), rng.standard_normal(64 * 40)
    assert model.coloured(white) @ field == pytest.approx(white @ model.adjoint(field), rel=1e-10)


def test_a_pole_is_no_part_of_the_terrain(drawn):
    heights = drawn[0].rows(drawn[0].place_m[:, 0] < 60)
    pole = np.argmin(np.linalg.norm(heights.place_m - [30.0, 0.0], axis=1))
    raised = replace(heights, height_m=heights.height_m + 12.0 * (np.arange(len(heights)) == pole))
    calm_ground = low_relief_mask(raised.above(np.zeros(3)), WINDOW)
    assert not calm_ground[pole]
    assert calm_ground[np.linalg.norm(heights.place_m - [30.0, 0.0], axis=1) > 25].mean() > 0.9


def test_false_heights_are_left_out_alone(drawn):
    """A hundredth, metres off, between which broken and calm ground stand as they are; the fit is that without them."""
    heights, _, _ = drawn
    false = np.arange(50, 600, 100)
    off = replace(heights, height_m=heights.height_m + np.where(np.isin(np.arange(600), false), 8.0, 0.0))
    kept = {name: consistent_mask(of.above(of.trend()), WINDOW, 4.0) for name, of in (("off", off), ("as", heights))}
    assert not kept["off"][false].any()
    assert kept["as"].mean() > 0.98
    assert np.delete(kept["off"], false).mean() > 0.98
    wanted, found, with_them = (
        fit_covariance(of.above(of.trend()).rows(mask), noise_factor_spread=1.0)
        for of, mask in ((heights, kept["as"]), (off, kept["off"]), (off, np.ones(600, dtype=bool)))
    )
    assert found.noise_factor == pytest.approx(wanted.noise_factor, rel=0.3)
    assert found.covariance.length_m == pytest.approx(wanted.covariance.length_m, rel=0.3)
    assert with_them.covariance.length_m < 0.2 * wanted.covariance.length_m
    few = heights.rows(np.arange(60))
    assert consistent_mask(few.above(few.trend()), WINDOW, 4.0).all()


def test_short_waves_that_footprints_average_away_are_no_higher_than_the_ground():
    """A crest in smooth ground, seen by wide footprints: their covariance leaves next to nothing for short waves."""
    rng = np.random.default_rng(6)
    smooth = Covariance(1.9, 23.0, 1.0)
    place = rng.uniform(0, 110, (600, 2))
    total = smooth.at(cdist(place, place), 4.5) + SIGMA_M**2 * np.eye(600)
    height = np.linalg.cholesky(total) @ rng.standard_normal(600) + 1.2 * np.exp(-0.5 * ((place[:, 0] - 80) / 3) ** 2)
    heights = Heights.at_places(place, height, np.full(600, SIGMA_M))
    measured = replace(heights.above(np.zeros(3)), spread_m=np.full(600, 4.5))
    found = local_relief(measured, FittedCovariance(smooth, 1.0), WINDOW)
    short_m2 = found.divided(smooth, 10.0, 0.0)[1].value_m2[0]
    assert np.exp(found.log_amplitude).max() * np.sqrt(short_m2) < 1.2


def test_tables_for_all_windows_are_those_of_each_window():
    """Between the spreads for which there are tables, too: within 0.0005 of the variance."""
    rng = np.random.default_rng(5)
    place, spread = rng.uniform(0, 50, (400, 2)), rng.uniform(0.3, 3.0, 400)
    heights = Heights.at_places(place, np.zeros(400), np.full(400, SIGMA_M))
    measured, member = (
        replace(heights.above(np.zeros(3)), spread_m=spread),
        rng.permuted(np.arange(400)).reshape(20, 20),
    )
    tables = DividedTables.of(measured, member, TERRAIN, BROKEN)
    middle = np.median(spread[member], axis=1)
    long, short = tables.between(place[member], middle)
    for k, own in enumerate(member):
        away = cdist(place[own], place[own])
        exact = [table.at(away) for table in BROKEN.divided(TERRAIN, 80.0, float(middle[k]))]
        for found, expected in zip((long[k], short[k]), exact, strict=True):
            np.testing.assert_allclose(found, expected, atol=5e-4 * TERRAIN.variance_m2)


def test_modes_of_a_covariance_that_rounding_left_indefinite():
    """They are those of the least raised one, which is definite; a definite one beside it is not touched."""
    rng = np.random.default_rng(2)
    base, rotation = rng.standard_normal((6, 6)), np.linalg.qr(rng.standard_normal((6, 6)))[0]
    short, rest = base @ base.T, (rotation * [5e5, 3e2, 2.0, 1.0, 0.3, -0.6]) @ rotation.T
    definite = rest + np.eye(6)
    shares, vectors = _modes(np.stack([short, short]), np.stack([rest, definite]))
    for share, vector, raised in zip(shares, vectors, (rest + 1.2 * np.eye(6), definite), strict=True):
        np.testing.assert_allclose(vector.T @ raised @ vector, np.eye(6), atol=1e-6)
        np.testing.assert_allclose(vector.T @ short @ vector, np.diag(share), atol=1e-6 * share.max())
    np.testing.assert_allclose(shares[1], eigh(short, definite, eigvals_only=True), rtol=1e-6)


def scanned(rng, walls_along: bool) -> Heights:
    """Heights on ten scan lines 5 m apart, over fields 12 m wide with walls of 1 m along the lines or across them."""
    x, y = np.meshgrid(5.0 * np.arange(10), np.arange(60.0))
    place = np.column_stack([x.T.ravel(), y.T.ravel()])
    across = place[:, 0] + 0.2 * place[:, 1] if walls_along else place[:, 1] + 0.2 * place[:, 0]
    height = np.floor(across / 12) + SIGMA_M * rng.standard_normal(len(place))
    order = np.concatenate([200.0 * line + np.arange(60) for line in range(10)])
    heights = Heights.at_places(place, height, np.full(len(place), SIGMA_M))
    return replace(heights, order=order)


@pytest.mark.parametrize(
    "local", [UNIFORM, LocalRelief(0.0, 0.0, 12.0, np.tile(np.linspace(-0.6, 1.0, 5), (6, 1)))], ids=["even", "uneven"]
)
def test_lines_left_out_are_predicted_by_the_others(local):
    """The error over its standard deviation, as by kriging about a plane with the line really left out."""
    rng = np.random.default_rng(8)
    heights = scanned(rng, walls_along=True)
    measured, own = heights.above(np.zeros(3)), np.argsort(np.hypot(*(heights.place_m - [21.0, 30.0]).T))[:40]
    others = own[np.abs(measured.order[own] - measured.order[own[0]]) > 100]
    place = measured.place_m
    away = np.column_stack([np.ones(len(others)), place[others] - place[own[0]]])
    total = covariance(place[others], place[others], local) + SIGMA_M**2 * np.eye(len(others))
    to_first, zero = covariance(place[others], place[own[:1]], local)[:, 0], np.zeros((3, 3))
    weight = np.linalg.solve(np.block([[total, away], [away.T, zero]]), np.concatenate([to_first, [1.0, 0.0, 0.0]]))
    before = covariance(place[own[:1]], place[own[:1]], local)[0, 0]
    variance = before + SIGMA_M**2 - weight @ np.concatenate([to_first, [1.0, 0.0, 0.0]])
    plainly = (measured.height_m[own[0]] - weight[:-3] @ measured.height_m[others]) / np.sqrt(variance)
    tables = DividedTables.of(measured, own[None], TERRAIN, local)
    # Beside it a window of one line alone, of which nothing is told.
    alone = np.argsort(np.hypot(*(heights.place_m - [20.0, 30.0]).T) + 100 * (heights.place_m[:, 0] != 20.0))[:40]
    found = _cross_line_errors(measured, np.array([alone, own]), FittedCovariance(TERRAIN, 1.0), local, tables)
    assert found == pytest.approx([plainly], rel=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_errors_are_wider_where_walls_run_along_the_scan_lines_alone(seed):
    """Neither over the same walls across the lines nor over ground as the covariance says."""
    rng = np.random.default_rng(seed)
    terrain = FittedCovariance(Covariance(1.0, 9.0, 0.05), 1.0)
    place = scanned(rng, walls_along=True)
    total = terrain.covariance.at(cdist(place.place_m, place.place_m)) + SIGMA_M**2 * np.eye(600)
    drawn = replace(place, height_m=np.linalg.cholesky(total) @ rng.standard_normal(600))

    def misfit(measured, fitted):
        return misfit_between_lines(measured, fitted, local_relief(measured, fitted, WINDOW), WINDOW)

    for heights, wider in ((place, True), (drawn, False)):
        assert (misfit(heights.above(np.zeros(3)), terrain) > 1) == wider
    along, across = (scanned(rng, walls).above(np.zeros(3)) for walls in (True, False))
    along, across = (misfit(each, fit_covariance(each)) for each in (along, across))
    assert along > 1.3
    assert across == 1.0


def test_chance_widens_one_map_in_thousands(monkeypatch):
    """Over ground as the covariance says; deviations of 1.6 times what it says are told."""
    rng = np.random.default_rng(11)
    terrain = FittedCovariance(Covariance(1.0, 9.0, 0.05), 1.0)
    place = scanned(rng, walls_along=True).above(np.zeros(3))
    # What is the same for all draws.
    kept = local_relief_module.decorrelated(place)
    monkeypatch.setattr(local_relief_module, "decorrelated", lambda _: kept)
    monkeypatch.setattr(local_relief_module.DividedTables, "of", lambda *_: None)

    def told(factor, draws):
        monkeypatch.setattr(local_relief_module, "_cross_line_errors", lambda *_: factor * rng.standard_normal(184))
        return np.mean([misfit_between_lines(place, terrain, None, WINDOW) > 1 for _ in range(draws)])

    assert told(1.0, 1500) < 2e-3
    assert told(1.6, 60) > 0.95
