"""Gridding: a plane comes back exactly, and cells that nothing was seen of stay empty."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from seen_points import seen_points
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.linear.gridding import grid_points

SHADOW_RAD = np.deg2rad(85)


def gridded(*given):
    return grid_points(*given).dem


def square(half_m: float, spacing_m: float = 1.0) -> Grid:
    return Grid.covering(*np.array([-half_m, -half_m, half_m, half_m], dtype=float), spacing_m)


def plane(x, y):
    return 3.0 + 0.25 * x - 0.1 * y


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(200, 600))
def test_a_plane_comes_back_exactly(seed, count):
    x, y = np.random.default_rng(seed).uniform(-30, 30, (2, count))
    dem = gridded(seen_points(np.column_stack([x, y, plane(x, y)])), square(20), 12.0, SHADOW_RAD)
    expected = plane(*dem.grid.centres_m.T).reshape(dem.grid.shape)
    assert dem.filled.mean() > 0.9
    np.testing.assert_allclose(dem.height_m[dem.filled], expected[dem.filled], atol=1e-9)


@settings(max_examples=30)
@given(st.floats(-3, 3), st.floats(0.5, 3), st.floats(-1e3, 1e3))
@example(turn=0.0, spacing=0.9695579949050228, shift=0.0)
def test_points_in_rows_are_no_hindrance(turn, spacing, shift):
    """Scan lines lie on straight lines, collinear but for rounding."""
    a, b = (k.ravel() * spacing + shift for k in np.meshgrid(np.arange(30), np.arange(20)))
    x, y = np.cos(turn) * a - np.sin(turn) * b, np.sin(turn) * a + np.cos(turn) * b
    grid = Grid.covering(x.min(), y.min(), x.max(), y.max(), spacing / 2)
    dem = gridded(
        seen_points(np.column_stack([x, y, plane(x, y)]), (shift, shift, 1000.0)), grid, 2 * spacing, SHADOW_RAD
    )
    u, v = np.cos(turn) * grid.centres_m[:, 0] + np.sin(turn) * grid.centres_m[:, 1], None
    v = -np.sin(turn) * grid.centres_m[:, 0] + np.cos(turn) * grid.centres_m[:, 1]
    deep = 0.01 * spacing  # just inside the outline
    inside = (u > a.min() + deep) & (u < a.max() - deep) & (v > b.min() + deep) & (v < b.max() - deep)
    expected = plane(*grid.centres_m.T)
    np.testing.assert_allclose(dem.height_m.ravel()[inside], expected[inside], atol=1e-7 * (1 + abs(shift)))


def test_cells_far_from_every_point_stay_empty():
    """A round hole in a carpet of points, too wide to close but narrow enough for triangles across it."""
    grid = square(10)
    x, y = grid.centres_m[np.hypot(*grid.centres_m.T) > 3.2].T
    dem = gridded(seen_points(np.column_stack([x, y, 0 * x])), grid, 2.5, SHADOW_RAD)
    distance = np.min(np.hypot(grid.centres_m[:, :1] - x, grid.centres_m[:, 1:] - y), axis=1).reshape(grid.shape)
    np.testing.assert_array_equal(dem.filled, distance <= 2.5)
    assert not dem.filled[10, 10]


def test_a_bay_of_the_outline_is_not_closed():
    """Two patches side by side: the triangles between them have sides far longer than the gap."""
    west = np.random.default_rng(6).uniform(-10, -6, (200, 2))
    east = west * [-1, 1]
    plan = np.concatenate([west, east])
    dem = gridded(seen_points(np.column_stack([plan, np.zeros(400)])), square(10, 0.5), 2.0, SHADOW_RAD)
    between = np.abs(dem.grid.centres_m[:, 0]).reshape(dem.grid.shape) < 5.9
    assert not np.any(dem.filled & between)
    assert np.any(dem.filled)


def test_nothing_is_made_up_outside_the_points():
    x, y = np.random.default_rng(1).uniform(-5, 5, (2, 400))
    dem = gridded(seen_points(np.column_stack([x, y, 0 * x])), square(12), 100.0, SHADOW_RAD)
    outside = np.abs(dem.grid.centres_m).max(axis=1).reshape(dem.grid.shape) > 5
    assert not np.any(dem.filled & outside)


def test_the_shadow_behind_an_edge_stays_empty():
    """A roof 10 m high ends at x = 0; from 30 m up and 20 m back its shadow on the ground reaches x = 10."""
    y = np.arange(-10.0, 10.5, 0.5)
    roof_x, ground_x = np.arange(-10.0, 0.25, 0.5), np.arange(10.0, 20.25, 0.5)
    roof, ground = (np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) for x in (roof_x, ground_x))
    position = np.concatenate(
        [np.column_stack([roof, np.full(len(roof), 10.0)]), np.column_stack([ground, np.zeros(len(ground))])]
    )
    origin = np.column_stack([np.full(len(position), -20.0), position[:, 1], np.full(len(position), 30.0)])
    points = seen_points(position, origin)
    grid = Grid(west_m=-8.75, south_m=-8.0, spacing_m=0.5, columns=55, rows=33)
    dem = gridded(points, grid, 6.0, SHADOW_RAD)
    shadow = (grid.x_m > 0) & (grid.x_m < 10)
    assert not np.any(dem.filled[:, shadow])
    assert np.all(dem.filled[:, ~shadow])
    np.testing.assert_allclose(dem.height_m[:, grid.x_m < 0], 10.0)
    np.testing.assert_allclose(dem.height_m[:, grid.x_m > 10], 0.0, atol=1e-12)
    # A slope with no points on as wide a stretch, seen from above, is no shadow.
    slope = np.column_stack([position[:, :2], -0.8 * position[:, 0]])
    assert np.all(gridded(seen_points(slope, (5.0, 0.0, 200.0)), grid, 6.0, SHADOW_RAD).filled)


def scattered(height, seed=3):
    place = np.random.default_rng(seed).uniform(-20, 20, (900, 2))
    return seen_points(np.column_stack([place, height(*place.T)]))


def test_nothing_is_interpolated_down_a_wall():
    dem = gridded(scattered(lambda x, y: np.where(x > 0.3, 8.0, 0.05 * y)), square(15.0), 5.0, SHADOW_RAD)
    x, y = np.meshgrid(dem.grid.x_m, dem.grid.y_m)
    truth = np.where(x > 0.3, 8.0, 0.05 * y)
    assert np.abs(dem.height_m - truth)[dem.filled].max() < 0.3
    assert dem.filled[np.abs(x - 0.3) > 4].all()
    assert not dem.filled[np.abs(x - 0.3) < 0.5].all()


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 90.0])
def test_nothing_is_interpolated_down_a_wall_between_lines_far_apart(turn_deg):
    """Over 6 m between two lines a wall of 5 m makes triangles of less than 45 deg."""
    x, y = np.meshgrid(np.arange(-27.0, 28.0, 6.0), np.arange(-30.0, 31.0, 1.5))
    turn = np.deg2rad(turn_deg)
    place = np.column_stack(
        [x.ravel() * np.cos(turn) - y.ravel() * np.sin(turn), (x * np.sin(turn) + y * np.cos(turn)).ravel()]
    )
    wall_x = 0.4
    height = np.where(place[:, 0] > wall_x, 5.0, 0.02 * place[:, 1])
    dem = gridded(seen_points(np.column_stack([place, height])), square(15.0), 6.0, SHADOW_RAD)
    x, y = np.meshgrid(dem.grid.x_m, dem.grid.y_m)
    truth = np.where(x > wall_x, 5.0, 0.02 * y)
    right = np.abs(dem.height_m - truth) < 0.1
    assert np.mean(right[dem.filled]) > 0.985
    assert dem.filled[np.abs(x - wall_x) > 7].all()


@pytest.mark.parametrize("slope", [0.8, 1.2, 2.0])
def test_steep_ground_is_no_wall(slope):
    """Ground that is as steep all over; a cliff between two plains counts as a wall."""

    def height(x, y):
        return slope * x + 0.3 * np.sin(y / 3)

    dem = gridded(scattered(height), square(15.0), 5.0, SHADOW_RAD)
    assert dem.filled.mean() > 0.99


def test_a_hillside_between_plains_is_no_wall():
    dem = gridded(scattered(lambda x, y: 0.8 * np.clip(x, -6, 6)), square(15.0), 5.0, SHADOW_RAD)
    assert dem.filled.mean() > 0.99


@pytest.mark.parametrize("slope", [0.4, 0.7, 0.9])
def test_creases_between_lines_far_apart_are_no_walls(slope):
    """A roof-shaped ridge, and a bank of up to 45 deg that is wider than the lines are apart."""
    x, y = np.meshgrid(np.arange(-27.0, 28.0, 6.0), np.arange(-30.0, 31.0, 1.5))
    for height in (-slope * np.abs(x - 1.0), slope * np.clip(x - 1.0, -7.0, 7.0)):
        position = np.column_stack([x.ravel(), y.ravel(), height.ravel()])
        assert gridded(seen_points(position), square(15.0), 6.0, SHADOW_RAD).filled.all()


def test_of_points_over_one_place_the_highest_counts():
    x, y = (k.ravel() for k in np.meshgrid(np.arange(5.0), np.arange(5.0)))
    low, high = (np.column_stack([x, y, np.full(25, z)]) for z in (0.0, 7.0))
    grid = Grid(west_m=0.5, south_m=0.5, spacing_m=1.0, columns=4, rows=4)
    for order in ([low, high], [high, low]):
        dem = gridded(seen_points(np.concatenate(order)), grid, 5.0, SHADOW_RAD)
        np.testing.assert_allclose(dem.height_m, 7.0)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 50])
def test_points_that_span_no_surface_give_an_empty_dem(count):
    line = np.column_stack([np.arange(count), np.zeros(count), np.zeros(count)])
    dem = gridded(seen_points(line), square(10), 5.0, SHADOW_RAD)
    assert not dem.filled.any()


def test_the_order_of_the_points_changes_nothing():
    random = np.random.default_rng(5)
    position = np.column_stack([random.uniform(-10, 10, (500, 2)), random.normal(size=500)])
    one = gridded(seen_points(position), square(8), 3.0, SHADOW_RAD)
    other = gridded(seen_points(position[random.permutation(500)]), square(8), 3.0, SHADOW_RAD)
    np.testing.assert_allclose(one.height_m, other.height_m, atol=1e-9)
