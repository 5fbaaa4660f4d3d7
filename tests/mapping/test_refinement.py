"""Maps that know their beam: their parts against analytic truth, and the whole on echoes made by brute force."""

from dataclasses import replace

import numpy as np
import pytest

from plain_echoes import PlainEchoes
from seen_points import seen_points
from sightings import CELL_M, CELLS, make_sightings
from sionna_radar import load_scenario, run
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.likelihood import EchoLikelihood, LandCover, Sightings, mean_ranges
from sionna_radar.inference.terrain.covariance import Covariance
from sionna_radar.inference.terrain.covariance_fit import fit_covariance
from sionna_radar.inference.terrain.heights import Heights
from sionna_radar.inference.terrain.smoothing import smooth
from sionna_radar.mapping.mapper import MapInputs
from sionna_radar.mapping.options import SMOOTH
from sionna_radar.mapping.refined.refinement import Smooth, refine, refining, smoothing
from sionna_radar.mapping.seen import seen_cells
from sionna_radar.mapping.tiles import Tiles, pieces_here

GRID = Grid(west_m=40.0, south_m=-25.0, spacing_m=1.0, columns=51, rows=51)
WIDE = Grid(west_m=-20.0, south_m=-100.0, spacing_m=1.0, columns=200, rows=200)


def hills(x_m, y_m):
    return 1.5 * np.sin(x_m / 9) * np.cos(y_m / 11)


def over(grid: Grid, height) -> Heightfield:
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    return Heightfield(grid=grid, height_m=height(x, y) + 0.0 * x)


@pytest.fixture(scope="module")
def hilly() -> Sightings:
    return make_sightings(over(WIDE, hills))


def test_rays_meet_a_plane_where_they_must():
    plane = over(WIDE, lambda x, y: 0.3 * x - 0.1 * y)
    direction = np.array([[0.6, 0.0, -0.8], [0.0, 0.6, -0.8], [0.0, 0.0, 1.0]])
    origin = np.broadcast_to([20.0, -10.0, 60.0], (3, 3))
    expected = 60 - 7.0
    hit = plane.first_hit(origin, direction, 200.0)
    assert hit[:2] == pytest.approx([expected / (0.8 + 0.18), expected / (0.8 - 0.06)], abs=2e-3)
    assert np.isnan(hit[2])


def test_rays_stop_at_the_first_of_two_walls():
    walls = over(WIDE, lambda x, y: np.where((np.abs(x - 30) < 1.5) | (np.abs(x - 60) < 1.5), 10.0, 0.0))
    hit = walls.first_hit(np.array([[0.0, 0.0, 5.0]]), np.array([[1.0, 0.0, 0.0]]), 150.0)
    assert hit[0] == pytest.approx(28.5, abs=0.6)


@pytest.mark.parametrize("smoothness", [0.5, 1.5, np.inf])
def test_covariances_have_their_variance_on_the_grid(smoothness):
    covariance = Covariance(smoothness, 8.0, 4.0)
    root = covariance.spectrum_root(WIDE)
    field = np.fft.irfft2(root**2, s=WIDE.shape)
    assert field[0, 0] == pytest.approx(4.0, rel=1e-6)
    assert field[0, 8] == pytest.approx(float(covariance.at(np.array([8.0]))[0]), rel=0.15)


def test_covariance_and_noise_are_learned():
    rng = np.random.default_rng(1)
    place = rng.uniform(0, 60, (150, 2))
    distance = np.linalg.norm(place[:, None] - place[None], axis=2)
    root = np.linalg.cholesky(Covariance(np.inf, 10.0, 4.0).at(distance) + 1e-6 * np.eye(150))
    z = root @ rng.standard_normal(150) + 0.3 * rng.standard_normal(150)
    heights = Heights.at_places(place, z, np.full(150, 0.15))
    measured = replace(heights.above(np.zeros(3)), detrended=False)  # the plane was not fitted to them
    fitted = fit_covariance(measured, noise_factor_spread=2.0)
    assert fitted.covariance.smoothness >= 2.0
    assert fitted.noise_factor == pytest.approx(4.0, rel=0.4)


def test_a_smoothing_surface_is_kriging():
    rng = np.random.default_rng(3)
    place = rng.uniform([40, -25], [90, 25], (200, 2))
    z = hills(*place.T) + 0.1 * rng.standard_normal(200)
    smoothed = smooth(Heights.at_places(place, z, np.full(200, 0.1)), GRID, window_heights=40)
    covariance, trend = smoothed.model.covariance, smoothed.model.trend
    K = covariance.at(np.linalg.norm(place[:, None] - place[None], axis=2))
    weight = np.linalg.solve(K + smoothed.noise_factor * 0.01 * np.eye(200), z - trend[0] - place @ trend[1:])
    spot = np.array([[60.0, 0.0], [75.0, 10.0]])
    kriged = covariance.at(np.linalg.norm(spot[:, None] - place[None], axis=2)) @ weight + trend[0] + spot @ trend[1:]
    # Bilinear between cells and periodic beyond the padding: nearly the same.
    assert smoothed.surface.at(*spot.T) == pytest.approx(kriged, abs=0.03)


def test_predicted_echoes_are_those_of_the_beam(hilly):
    predicted = EchoLikelihood(hilly, over(WIDE, hills)).centroid_m()
    error = mean_ranges(hilly).range_m - predicted
    assert abs(np.mean(error)) < 4 * np.std(error) / np.sqrt(len(error))
    assert 0.7 < np.std(error) / np.sqrt(np.mean(mean_ranges(hilly).sigma_m ** 2)) < 1.4


def test_the_score_vanishes_on_average_on_the_truth_and_points_back_from_elsewhere(hilly):
    truth = EchoLikelihood(hilly, over(WIDE, hills)).linearise(np.ones(len(hilly)))
    information = float(np.sum(truth.factor.sum(axis=1) ** 2))
    assert abs(truth.score.sum()) < 4 * np.sqrt(information)
    raised = EchoLikelihood(hilly, over(WIDE, lambda x, y: hills(x, y) + 0.2)).linearise(np.ones(len(hilly)))
    assert -raised.score.sum() / information == pytest.approx(0.2, rel=0.3)


def test_ground_on_both_sides_of_the_unambiguous_range_is_where_it_is(hilly):
    """Profiles end within the echoes: what is predicted in front of that misses nothing, whatever lies beyond."""
    cells = 245
    power = hilly.profiles.power.reshape(len(hilly), CELLS)[:, :cells]
    profiles = replace(hilly.profiles, power=power.ravel(), start=np.arange(len(hilly) + 1) * cells)
    cut = replace(hilly, profiles=profiles, reach_m=cells * CELL_M)
    model = EchoLikelihood(cut, over(WIDE, hills))
    assert np.mean(np.nanmax(model.footprints.range_m, axis=1) > cut.reach_m) > 0.9
    truth = model.linearise(np.ones(len(cut)))
    assert abs(truth.score.sum()) < 4 * np.sqrt(np.sum(truth.factor.sum(axis=1) ** 2))
    error = mean_ranges(cut).range_m - model.centroid_m()
    assert abs(np.mean(error)) < 4 * np.std(error) / np.sqrt(len(error))


def test_scores_vary_as_the_weights_of_their_cells_say(hilly):
    """A faint cell counts for little, and its residual is known better than it counts for."""
    looks = hilly.looks_per_cell
    truth = EchoLikelihood(hilly, over(WIDE, hills)).linearise(np.full(len(hilly), looks))
    raised = np.sqrt(truth.weight) * truth.factor.sum(axis=1)
    beside = np.zeros(len(raised))
    # Rows that belong to no echo are zero, and stand between any two.
    inside = np.setdiff1d(np.arange(len(raised) - 1), truth.first[1:] - 1)
    beside[inside] = (1 / looks - 1) * raised[inside] * raised[inside + 1]
    expected = looks * np.sum(raised**2 + beside)
    # The level of an echo is fitted to its own cells, which takes a part of their scatter.
    assert 0.7 < np.sum(truth.score.sum(axis=1) ** 2) / expected < 1.15


def test_refinement_beats_points_on_the_axis(hilly):
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    surface = refine(hilly, GRID).surface
    inside = (x > 50) & (x < 80) & (np.abs(y) < 20)
    refined = np.sqrt(np.mean((surface.height_m - hills(x, y))[inside] ** 2))
    ranges = mean_ranges(hilly)
    axis = hilly.pose.position_m + ranges.range_m[:, None] * hilly.pose.boresight
    plain = np.sqrt(np.mean((axis[:, 2] - hills(axis[:, 0], axis[:, 1])) ** 2))
    assert refined < 0.1
    assert refined < 0.4 * plain


FINE = Grid(west_m=0.0, south_m=-60.0, spacing_m=0.25, columns=600, rows=480)


@pytest.fixture(scope="module")
def striped() -> tuple[Sightings, LandCover]:
    """Strips 20 dB apart, by brute force: the mean range of a beam over two of them is the brighter one's."""

    def bright(x_m, y_m):
        return (x_m + 0.5 * y_m) // 6 % 2 == 0

    on_cells = bright(FINE.x_m[None], FINE.y_m[:, None]).astype(np.uint16)
    cover = LandCover(grid=FINE, cover=on_cells, gamma=np.outer([0.01, 1.0], np.ones(90)))
    return make_sightings(over(WIDE, hills), bright=lambda place: np.where(bright(*place.T[:2]), 1.0, 0.01)), cover


def rms_inside_m(sightings, tiling):
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    inside = (x > 50) & (x < 80) & (np.abs(y) < 20)
    surface = Tiles(sightings, GRID, tiling).mapped(pieces_here).surface
    return np.sqrt(np.mean((surface.height_m - hills(x, y))[inside] ** 2))


@pytest.fixture(scope="module")
def unaware_m(striped):
    """RMS error of a map that knows nothing of the strips."""
    return rms_inside_m(striped[0], smoothing(SMOOTH))


@pytest.mark.parametrize("method", [smoothing, refining])
def test_maps_that_know_the_cover_see_past_it(method, striped, unaware_m):
    lit, cover = striped
    known = rms_inside_m(replace(lit, cover=cover), method(SMOOTH))
    assert known < 0.2
    assert known < 0.2 * unaware_m


def test_borders_of_covers_stay_where_they_are_when_the_ground_rises(striped):
    """A border is nearer by cos(45 deg) of a rise, a ray on one cover by 1 / cos(45 deg): echoes tell both apart."""
    lit, cover = striped
    lit = replace(lit.rows(np.arange(len(lit)) % 2 == 0), cover=cover)
    plain = PlainEchoes(lit, over(WIDE, lambda x, y: 0.0))
    power = np.concatenate([1e6 * plain.expected(pulse) for pulse in range(len(lit))]).astype(np.float32)
    # Without speckle, ground of a wrong height is found to be so by just as much.
    lit = replace(lit, profiles=replace(lit.profiles, power=power))
    scores, factors = [], []
    for up_m in (-0.01, 0.0, 0.01):
        found = EchoLikelihood(lit, over(WIDE, lambda x, y, up_m=up_m: up_m)).linearise(np.ones(len(lit)))
        scores.append(found.score.sum(axis=1))
        factors.append(np.add.reduceat(found.factor.sum(axis=1) ** 2, found.first))
    found_m = (scores[0] - scores[2]) / 2 / factors[1]
    assert np.median(found_m) == pytest.approx(0.01, rel=0.01)
    assert np.mean(np.abs(found_m - 0.01) < 0.001) > 0.9


def test_shadows_stay_empty(hilly):
    # Behind the wall, seen from the west at 45 deg, 10 m of ground are hidden.
    wall = over(WIDE, lambda x, y: np.where(np.abs(x - 60) < 1.5, 10.0, 0.0))
    seen = seen_cells(replace(hilly, pose=hilly.pose), wall, GRID, 5.0)
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    middle = np.abs(y) < 10
    assert not seen[middle & (x > 63) & (x < 67)].any()
    assert seen[middle & (x > 50) & (x < 57)].mean() > 0.9


def test_a_few_frames_of_many_points_are_mapped():
    rng = np.random.default_rng(3)
    place = rng.uniform(0, 20, (60, 2))
    position = np.column_stack([place, 0.1 * place[:, 0] + rng.normal(0, 0.05, 60)])
    frame = {"pulse": np.repeat([0, 1, 2], 20), "number": np.tile(np.arange(20), 3)}
    points = seen_points(position, (10.0, 10.0, 50.0), **frame, range_sigma_m=np.full(60, 0.05))
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=20, rows=20)
    given = MapInputs(points=points, sightings=None, grid=grid, max_gap_m=5.0, shadow_incidence_rad=1.4)
    error = Smooth()(given).dem.height_m - 0.1 * grid.centres_m[:, 0].reshape(grid.shape)
    assert np.isfinite(error).sum() >= 20
    assert np.sqrt(np.nanmean(error**2)) < 0.05


def test_what_stands_on_even_ground_is_not_left_out():
    """Boxes on a plane, whose likeliest variance is none: with it the map is the plane, and nothing is as stated."""
    survey = run(load_scenario("buildings", {"dem.method": "smooth", "seed": 1}))
    error_m, sigma_m = survey.error.height_m, survey.dem_sigma.height_m
    known = np.isfinite(error_m) & np.isfinite(sigma_m)
    assert survey.lit_error.rms_m < 1.4
    assert np.median(np.abs(error_m[known])) < 0.2
    assert np.mean(np.abs(error_m[known]) < 1.96 * sigma_m[known]) > 0.5
