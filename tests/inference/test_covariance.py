"""The fit of a covariance against the plain likelihood of a Gaussian."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.optimize import approx_fprime
from scipy.spatial.distance import cdist
from scipy.stats import multivariate_normal

from sionna_radar.inference.terrain.covariance import Covariance, CovarianceTable
from sionna_radar.inference.terrain.covariance_fit import (
    PRIOR_NEPERS_SMOOTHNESS,
    TABLE,
    Group,
    Measured,
    _loss,
    _planes,
    fit_covariance,
    neighbours,
    repeated,
)
from sionna_radar.inference.terrain.heights import Heights

TERRAIN = Covariance(1.5, 8.0, 2.0)


@pytest.fixture(scope="module")
def measured():
    rng = np.random.default_rng(3)
    count = 30
    return Measured(
        place_m=rng.uniform(0, 40, (count, 2)),
        height_m=rng.standard_normal(count),
        sigma_m=rng.uniform(0.1, 0.3, count),
        spread_m=np.full(count, 1.2),
        order=np.arange(count, dtype=float),
        reach=np.full(count, 2.0),
    )


@pytest.mark.parametrize(
    ("microrelief_m", "detrended", "groups"), [(0.0, False, 1), (0.6, False, 1), (0.0, True, 1), (0.6, True, 2)]
)
def test_the_loss_is_that_of_a_gaussian_and_its_gradient_points_up(measured, microrelief_m, detrended, groups):
    logs, spread = np.log([6.0, 1.5, 1.2, 1.3]), 0.2
    # Contrasts that no plane changes: the null space of constants and slopes.
    planes = np.column_stack([np.ones(30), measured.place_m])
    contrasts = null_space(planes.T) if detrended else np.eye(30)
    rows = np.array_split(np.arange(30), groups)
    together = np.kron(np.eye(groups), np.ones((30 // groups,) * 2))

    def plain(logs):
        length, variance, factor, smoothness = np.exp(logs)
        away = np.linalg.norm(measured.place_m[:, None] - measured.place_m, axis=2)
        terrain = Covariance(smoothness, length, variance, microrelief_m).at(away, 1.2)
        noise = factor * np.outer(measured.sigma_m, measured.sigma_m)
        total = (terrain + noise * repeated(measured.order, measured.reach)) * together
        gaussian = multivariate_normal(cov=contrasts.T @ total @ contrasts)
        prior = logs[2] ** 2 / (2 * spread**2) + PRIOR_NEPERS_SMOOTHNESS * np.log1p(smoothness) - logs[1] / 2
        return -gaussian.logpdf(contrasts.T @ measured.height_m) - contrasts.shape[1] * np.log(2 * np.pi) / 2 + prior

    basis = _planes(measured.place_m) if detrended else None
    loss, gradient = _loss(logs, [Group.of(measured, own, basis) for own in rows], microrelief_m, spread)
    assert loss == pytest.approx(plain(logs), abs=1e-2)
    np.testing.assert_allclose(gradient, approx_fprime(logs, plain), rtol=0.02, atol=0.02)


def test_what_memory_held_before_warns_of_nothing_and_changes_nothing(measured, monkeypatch):
    """Of a symmetric matrix one triangle is written, and all of it subtracted from."""
    detrended, empty = replace(measured, detrended=True), np.empty
    expected = fit_covariance(detrended)

    def dirty(shape, dtype=float, **given):
        memory = empty(shape, dtype, **given)
        if memory.dtype == np.float64:
            memory.view(np.uint64)[...] = 0x7FF0_0000_0000_0001  # arithmetic with which is invalid
        return memory

    monkeypatch.setattr(np, "empty", dirty)
    assert fit_covariance(detrended) == expected


def test_the_variance_of_a_short_flight_is_not_that_which_a_plane_leaves():
    """Waves longer than the patch: a plane explains most of them, and what it leaves says too little."""
    rng, ground = np.random.default_rng(5), Covariance(1.5, 60.0, 4.0)
    x, y = np.meshgrid(np.arange(0, 60, 5.0), np.arange(0, 30, 5.0))
    place = np.column_stack([x.ravel(), y.ravel()])
    root = np.linalg.cholesky(ground.at(cdist(place, place)) + 1e-6 * np.eye(len(place)))
    fitted = {True: [], False: []}
    for _ in range(12):
        heights = Heights.at_places(place, root @ rng.standard_normal(len(place)), np.full(len(place), 0.05))
        above = heights.above(heights.trend())
        for detrended, found in fitted.items():
            tried = fit_covariance(replace(above, detrended=detrended), 1).covariance
            found.append(2 * (tried.variance_m2 - tried.at(np.array([30.0]))[0]))
    # Differences over half of the patch's length: their standard deviation is to hold within 30 %.
    true = np.sqrt(2 * (ground.variance_m2 - ground.at(np.array([30.0]))[0]))
    reml, ml = np.mean(np.sqrt(fitted[True])), np.mean(np.sqrt(fitted[False]))
    assert reml == pytest.approx(true, rel=0.3)
    assert ml < 0.8 * true


def test_the_variance_of_even_ground_is_what_the_heights_cannot_tell_from_none():
    """Planes under noise: the fit leaves about a standard error, never none, and less where there are more heights."""
    rng, found = np.random.default_rng(8), []
    for count in (40, 160):
        place, left = rng.uniform(0, 60, (count, 2)), []
        for _ in range(12):
            heights = Heights.at_places(
                place, 0.1 * place[:, 0] + 0.2 * rng.standard_normal(count), np.full(count, 0.2)
            )
            fitted = fit_covariance(heights.above(heights.trend()), 1).covariance
            left.append(fitted.variance_m2)
        found.append(np.sqrt(left))
    # The lower bound of the search is 0.002 m.
    assert found[0].min() > 0.01
    assert np.median(found[1]) < np.median(found[0]) < 0.2


def test_places_on_a_line_have_no_slope_across_it():
    rng = np.random.default_rng(6)
    along = np.sort(rng.uniform(0, 50, 40))
    place = np.column_stack([0.6 * along, 0.8 * along])
    heights = Heights.at_places(place, np.sin(along / 5) + 0.1 * along, np.full(40, 0.05))
    (group,) = neighbours(heights.above(heights.trend()))
    assert group.planes.shape == (40, 2)
    assert np.isfinite(fit_covariance(heights.above(heights.trend()), 1).covariance.variance_m2)


def test_heights_1_m_apart_differ_by_the_microrelief():
    ground = Covariance(np.inf, 1e6, 1.0, microrelief_m=0.05)  # on landforms that are level over 1 m
    difference_m2 = 2 * (ground.at(np.zeros(1)) - ground.at(np.ones(1)))
    assert np.sqrt(difference_m2)[0] == pytest.approx(0.05, rel=1e-3)


def test_landforms_of_real_ground_are_no_smoother_than_lidar_finds_them():
    """Smooth hills under noise: with microrelief, which real ground has, the fit keeps waves below the spacing."""
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.arange(0, 70, 5.0), np.arange(0, 70, 2.5))
    place = np.column_stack([x.ravel(), y.ravel()])
    total = Covariance(np.inf, 20.0, 4.0).at(cdist(place, place)) + 0.1**2 * np.eye(len(place))
    height = np.linalg.cholesky(total) @ rng.standard_normal(len(place))
    heights = Heights.at_places(place, height, np.full(len(place), 0.1))

    def about(microrelief_m):
        return replace(heights.above(np.zeros(3), microrelief_m), detrended=False)

    synthetic, real = (fit_covariance(each).covariance for each in (about(0.0), about(0.03)))
    assert synthetic.smoothness > 4
    assert 1.0 <= real.smoothness <= 1.6
    # Second differences over 2 m, relative to those over 16 m.
    share = [
        (6 * c[0] - 8 * c[1] + 2 * c[2]) / (6 * c[0] - 8 * c[3] + 2 * c[4])
        for c in (ground.landforms.at(np.array([0.0, 2.0, 4.0, 16.0, 32.0])) for ground in (synthetic, real))
    ]
    assert share[1] > 4 * share[0]


def test_a_table_gives_the_covariance_between_places(measured):
    table = TERRAIN.table(60.0, 0.7)
    away = np.linalg.norm(measured.place_m[:, None] - measured.place_m[:7], axis=2)
    np.testing.assert_allclose(table.between(measured.place_m, measured.place_m[:7]), TERRAIN.at(away, 0.7), atol=1e-5)
    np.testing.assert_allclose(table.at(away), np.interp(away, CovarianceTable.distances(60.0), table.value_m2))


def test_nothing_lies_beyond_a_groups_table(measured):
    group = Group.of(measured, np.arange(30))
    assert group.entry.max() == TABLE - 2
    assert group.fraction.min() >= 0
    assert group.fraction.max() <= 1


def test_speckle_that_dense_pulses_share_does_not_pass_for_rough_ground():
    """Smooth ground in lines 4 m apart of pulses every 0.2 m, whose noise is shared in another way than is modelled."""
    rng = np.random.default_rng(8)
    along, line = np.meshgrid(np.arange(0, 40, 0.2), np.arange(0, 40, 4.0))
    place = np.column_stack([along.ravel(), line.ravel()])
    wave = rng.normal(0.0, 0.2, (200, 2))
    ground = np.cos(place @ wave.T + rng.uniform(0, 2 * np.pi, 200)).sum(axis=1) / 10
    noise = np.zeros(len(place))
    for number in range(1, len(place)):
        noise[number] = np.exp(-1 / 6) * noise[number - 1] + rng.normal(0.0, 0.1)
    noise *= 0.15 / noise.std()
    dense = Measured(
        place_m=place,
        height_m=ground + noise,
        sigma_m=np.full(len(place), 0.15),
        spread_m=np.full(len(place), 0.5),
        order=np.arange(len(place), dtype=float),
        reach=np.full(len(place), 6.0),
    )
    assert fit_covariance(dense).covariance.smoothness > 1.5
    (group, *_) = neighbours(dense)
    assert group.table_m.max() > 40.0  # few of many pulses, over all of the ground


def test_waves_shorter_than_a_footprint_are_not_told_apart():
    """Echoes of something else look like waves of any variance, so long as they are shorter than the footprint."""
    rng = np.random.default_rng(4)
    count = 300
    height = rng.normal(0.0, 0.2, count)
    height[::7] += rng.normal(0.0, 8.0, len(height[::7]))
    scattered = Measured(
        place_m=rng.uniform(0, 80, (count, 2)),
        height_m=height,
        sigma_m=np.full(count, 0.1),
        spread_m=np.full(count, 0.7),
        order=np.arange(count, dtype=float),
        reach=np.zeros(count),
    )
    assert fit_covariance(scattered).covariance.length_m >= 0.7 * (1 - 1e-9)
