"""Rays against surfaces whose heights are known in closed form."""

import numpy as np
import pytest

from sionna_radar.foundation.raster import Grid
from sionna_radar.scene.model import Surface
from sionna_radar.scene.raycast import RayCaster, truth_dem
from worlds import make_surface


def box_top(x_from, x_to, height, name="roof") -> Surface:
    """A horizontal rectangle in the air, from y = -10 to 10."""
    vertices = np.array(
        [[x_from, -10, height], [x_to, -10, height], [x_to, 10, height], [x_from, 10, height]], dtype=float
    )
    return Surface(name=name, vertices_m=vertices, faces=np.array([[0, 1, 2], [0, 2, 3]]), material="ground")


@pytest.fixture(scope="module")
def caster():
    """A slope with a roof 20 m up between x = 0 and 8."""
    return RayCaster([make_surface(lambda x, y: 0.1 * x, size_m=100.0), box_top(0.0, 8.0, 20.0)])


def test_distances_and_surfaces(caster):
    origin = np.array([[-20.0, 0, 50], [4, 0, 50], [4, 0, 10], [0, 0, 50], [500, 0, 50]])
    direction = np.array([[0, 0, -1], [0, 0, -1], [0, 0, -1], [0, 0, 1], [0, 0, -1.0]])
    hits = caster.cast(origin, direction)
    np.testing.assert_allclose(hits.distance_m, [52, 30, 9.6, np.inf, np.inf], atol=1e-4)
    np.testing.assert_array_equal(hits.surface, [0, 1, 0, -1, -1])
    np.testing.assert_array_equal(hits.hit, [True, True, True, False, False])


def test_a_slanted_ray(caster):
    # Down at 45 deg to the west from (0, 0, 30), where z = 30 + x, it meets the slope at 30 + x = 0.1 x.
    direction = np.array([[-1.0, 0.0, -1.0]]) / np.sqrt(2)
    expected = np.sqrt(2) * 30 / 0.9
    assert caster.cast(np.array([[0.0, 0.0, 30.0]]), direction).distance_m[0] == pytest.approx(expected, abs=1e-4)


def test_heights_from_above_and_from_below(caster):
    place = np.array([[4.0, 0.0], [-4.0, 0.0], [4.0, 12.0], [80.0, 0.0]])
    np.testing.assert_allclose(caster.from_above(place, 100.0), [20.0, -0.4, 0.4, np.nan], atol=1e-4)
    np.testing.assert_allclose(caster.from_below(place, -100.0), [0.4, -0.4, 0.4, np.nan], atol=1e-4)


def test_visibility(caster):
    origin = np.tile([4.0, 0.0, 50.0], (5, 1))
    point = np.array([[4, 0, 20.0], [4, 0, 0.4], [4, 30, 0.4], [-30, 0, -3.0], [4, 0, 30]])
    np.testing.assert_array_equal(caster.visible(origin, point), [True, False, True, True, True])


def test_a_point_within_the_tolerance_under_the_surface_is_seen(caster):
    origin, point = np.array([[-20.0, 0, 50.0]]), np.array([[-20.0, 0, -2.03]])
    assert not caster.visible(origin, point)[0]
    assert caster.visible(origin, point, 0.05)[0]


def test_the_truth_is_the_mesh_seen_from_above(caster):
    grid = Grid(west_m=-9.75, south_m=-9.75, spacing_m=0.5, columns=40, rows=30)
    truth = truth_dem(caster, grid, 60.0)
    x = np.broadcast_to(grid.x_m, grid.shape)
    expected = np.where((x > 0) & (x < 8), 20.0, 0.1 * x)
    np.testing.assert_allclose(truth.height_m, expected, atol=1e-4)


def test_the_truth_is_empty_beyond_the_mesh():
    caster = RayCaster([make_surface(lambda x, y: 0 * x, size_m=10.0)])
    truth = truth_dem(caster, Grid(west_m=-6.0, south_m=0.0, spacing_m=4.0, columns=4, rows=1), 10.0)
    np.testing.assert_array_equal(truth.filled, [[False, True, True, False]])


def test_a_mesh_lies_on_its_corners_between_cells():
    """Heights over a triangle are linear: the mesh of a bumpy raster is tested against its own corners."""
    bumps = make_surface(lambda x, y: np.sin(x) * np.cos(2 * y), size_m=20.0, spacing_m=1.0)
    place = np.random.default_rng(1).uniform(-9.9, 9.9, (500, 2))
    low = np.floor(place)
    s, t = (place - low).T
    a, b, c, d = (np.sin(low[:, 0] + i) * np.cos(2 * (low[:, 1] + j)) for j in (0, 1) for i in (0, 1))
    # Corners a b below, c d above, split along a-d.
    expected = np.where(s >= t, a + s * (b - a) + t * (d - b), a + t * (c - a) + s * (d - c))
    np.testing.assert_allclose(RayCaster([bumps]).from_above(place, 50.0), expected, atol=1e-4)
