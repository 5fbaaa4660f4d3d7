"""The machine code of the forward model against the same model with plain arrays, one pulse after the other."""

from dataclasses import replace

import numpy as np
import pytest

from plain_echoes import PlainEchoes
from sightings import make_sightings
from sionna_radar.detection.echoes import VolumeInFront
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.kernels import _gain_of_cells, _whitened
from sionna_radar.inference.echo.likelihood import EchoLikelihood, LandCover, footprints
from sionna_radar.mapping.refined.curvature import _by_nodes, curvature_on_cells

WIDE = Grid(west_m=-20.0, south_m=-100.0, spacing_m=1.0, columns=200, rows=200)
PULSES = 12
LOOKS = 0.7


def hills(x_m, y_m):
    return 1.5 * np.sin(x_m / 9) * np.cos(y_m / 11)


@pytest.fixture(scope="module")
def surface():
    x, y = np.meshgrid(WIDE.x_m, WIDE.y_m)
    return Heightfield(grid=WIDE, height_m=hills(x, y))


@pytest.fixture(scope="module")
def in_clear_air(surface):
    every = make_sightings(surface)
    some = every.rows(np.arange(len(every)) % (len(every) // PULSES) == 0)
    window = np.array([0.02, 0.3, 1.0, 0.3, 0.02])
    return replace(some, response=window, doppler=1.0, pose=replace(some.pose, velocity_mps=some.pose.boresight * 9.0))


@pytest.fixture(scope="module")
def in_rain(in_clear_air):
    count, values = len(in_clear_air), len(in_clear_air.profiles.power)
    typical = float(np.percentile(in_clear_air.profiles.power, 99))
    volume = VolumeInFront(
        power=np.full(values, 0.1 * typical, dtype=np.float32),
        in_air=np.ones(values, dtype=np.float32),
        echo_m=np.full(count, 70.0),
        echo_sigma_m=np.full(count, 0.1),
        direction=np.tile([1.0, 0.0, 0.0], (count, 1)),
        echo_reach=np.zeros(count),
        drift_m=np.linspace(-0.4, 0.8, count),
        spread_m=0.5,
    )
    return replace(in_clear_air, profiles=replace(in_clear_air.profiles, volume=volume))


@pytest.fixture(scope="module")
def over_covers(in_rain):
    """In rain over two covers in strips, which of them is brighter depends on the incidence."""
    grid = Grid(west_m=20.0, south_m=-40.0, spacing_m=0.5, columns=160, rows=160)
    strips = ((grid.x_m[None] + 0.4 * grid.y_m[:, None]) // 3 % 2).astype(np.uint16)
    gamma = np.stack([np.full(90, 0.1), np.geomspace(20.0, 2e-4, 90)])
    return replace(in_rain, cover=LandCover(grid=grid, cover=strips, gamma=gamma))


@pytest.fixture(scope="module")
def over_covers_in_clear_air(in_clear_air, over_covers):
    return replace(in_clear_air, cover=over_covers.cover)


@pytest.mark.parametrize("air", ["in_clear_air", "in_rain", "over_covers", "over_covers_in_clear_air"])
def test_score_and_curvature_are_those_of_the_plain_model(air, surface, request):
    sightings = request.getfixturevalue(air)
    looks = LOOKS * np.linspace(1, 2, len(sightings))
    linear = EchoLikelihood(sightings, surface).linearise(looks)
    plain = PlainEchoes(sightings, surface)
    for pulse in range(len(sightings)):
        score, factor = plain.pulse(pulse, looks[pulse])
        own = linear.rows_of(pulse)
        assert len(factor) > 10
        np.testing.assert_allclose(linear.factor[own], factor, rtol=1e-5, atol=1e-6 * np.abs(factor).max())
        np.testing.assert_allclose(linear.score[pulse], score, rtol=1e-7, atol=1e-9 * np.abs(score).max())
        np.testing.assert_allclose(linear.residual[own] @ factor, score, rtol=1e-5, atol=1e-7 * np.abs(score).max())


@pytest.mark.parametrize("operator", [curvature_on_cells, _by_nodes])
def test_the_curvature_of_all_echoes_is_that_of_their_rows(in_clear_air, surface, operator):
    linear = EchoLikelihood(in_clear_air, surface).linearise(np.ones(len(in_clear_air)))
    heights = np.random.default_rng(1).standard_normal(surface.height_m.size)
    expected = np.zeros_like(heights)
    for pulse in range(len(in_clear_air)):
        weights = surface.weights(*linear.place_m[pulse].T)
        factor = linear.factor[linear.rows_of(pulse)].astype(float)
        expected += weights.T @ (factor.T @ (factor @ (weights @ heights)))
    np.testing.assert_allclose(operator(linear, surface.grid)(heights), expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("ground", ["in_clear_air", "over_covers"])
def test_mean_ranges_are_those_of_the_plain_model(ground, surface, request):
    sightings = request.getfixturevalue(ground)
    expected = PlainEchoes(sightings, surface).centroid_m()
    np.testing.assert_allclose(EchoLikelihood(sightings, surface).centroid_m(), expected, rtol=1e-12)


def test_one_cover_is_as_none(in_clear_air, surface):
    one = LandCover(grid=WIDE, cover=np.ones(WIDE.shape, dtype=np.uint16), gamma=np.outer([1.0, 7.0], np.ones(90)))
    covered = EchoLikelihood(replace(in_clear_air, cover=one), surface).centroid_m()
    np.testing.assert_array_equal(covered, EchoLikelihood(in_clear_air, surface).centroid_m())


def test_a_pulse_alone_gives_the_same_bits_as_among_others(in_rain, surface):
    looks = np.ones(len(in_rain))
    together = EchoLikelihood(in_rain, surface).linearise(looks)
    for pulse in (0, 5):
        alone = EchoLikelihood(in_rain.rows(np.arange(len(in_rain)) == pulse), surface).linearise(looks[:1])
        np.testing.assert_array_equal(alone.score[0], together.score[pulse])
        np.testing.assert_array_equal(alone.factor[alone.rows_of(0)], together.factor[together.rows_of(pulse)])


def test_cells_without_power_of_the_echo_leave_nothing_to_project_out():
    """As behind drops that a first echo was taken from: the cells that count are the volume's."""
    cells, nodes = 6, 3
    shape, weight = np.eye(cells)[0], np.arange(cells) > 0
    echo = 1e-12, shape, np.ones(cells), weight.astype(float)
    power, gain = np.full(cells, 2.0), np.empty(cells)
    assert _gain_of_cells(power, echo, 1.0, gain) == cells - 1
    np.testing.assert_array_equal(gain, weight * 1e-12)
    jacobian, score, factor = np.ones((cells, nodes)), np.zeros(nodes), np.empty((cells - 1, nodes))
    residual, weight_of = np.empty(cells - 1), np.empty(cells - 1)
    _whitened(echo, power, 1.0, jacobian, np.zeros(nodes), score, factor, (1, 0), residual, weight_of)
    np.testing.assert_array_equal(factor, 1.0)
    np.testing.assert_array_equal(score, cells - 1)


def test_a_pulse_that_meets_nothing_says_nothing(in_clear_air, surface):
    upward = in_clear_air.pose.R_world_antenna * np.array([1.0, 1.0, -1.0])[:, None]
    linear = EchoLikelihood(
        replace(in_clear_air, pose=replace(in_clear_air.pose, R_world_antenna=upward)), surface
    ).linearise(np.ones(len(in_clear_air)))
    np.testing.assert_array_equal(linear.first, linear.last)
    np.testing.assert_array_equal(linear.score, 0.0)
    np.testing.assert_array_equal(curvature_on_cells(linear, surface.grid)(np.ones(surface.height_m.size)), 0.0)


@pytest.mark.parametrize("air", ["in_clear_air", "in_rain", "over_covers_in_clear_air"])
def test_the_score_alone_is_that_of_the_rows(air, surface, request):
    sightings = request.getfixturevalue(air)
    model, looks = EchoLikelihood(sightings, surface), LOOKS * np.linspace(1, 2, len(sightings))
    expected = model.linearise(looks).score
    np.testing.assert_allclose(model.score(looks), expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())


def test_beams_meet_a_surface_that_moved_a_little_where_they_meet_it_anew(in_clear_air, surface):
    before = footprints(in_clear_air, surface)
    moved = replace(surface, height_m=surface.height_m + 0.05 * np.sin(WIDE.x_m / 5))
    expected, found = footprints(in_clear_air, moved), footprints(in_clear_air, moved, near=before)
    np.testing.assert_allclose(found.range_m, expected.range_m, atol=1e-9)
    np.testing.assert_allclose(found.range_per_height, expected.range_per_height, atol=1e-6)
