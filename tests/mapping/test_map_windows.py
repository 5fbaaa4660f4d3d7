"""Maps in windows: all cells once, few points in each, and the map that all points make at once."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seen_points import seen_points
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.linear import gridding
from sionna_radar.mapping.linear.gridding import grid_points, windows_of
from sionna_radar.mapping.points import Points

SHADOW_RAD = np.deg2rad(85)


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.integers(1, 60), st.integers(1, 60), st.integers(1, 200), st.floats(0.1, 20.0))
def test_windows_are_the_grid(seed, rows, columns, most, least_m):
    grid = Grid(west_m=-7.0, south_m=3.0, spacing_m=0.5, rows=rows, columns=columns)
    generator = np.random.default_rng(seed)
    place = generator.normal(grid.centres_m.mean(axis=0), [0.2 * columns, 0.3 * rows], (500, 2))
    windows = windows_of(grid, place, most, least_m)
    times = np.zeros(grid.shape, dtype=int)
    for window in windows:
        times[window.rows, window.columns] += 1
        inside = np.isin(np.arange(len(place)), np.flatnonzero(window.around(place, 0.0)))
        sides = [0.5 * (side.stop - side.start) for side in (window.rows, window.columns)]
        assert len(windows) == 1 or min(sides) >= min(least_m, 0.5 * min(rows, columns))
        assert inside.sum() <= most or max(sides) < 2 * least_m + 1.0
    assert (times == 1).all()


def rough_survey(seed: int) -> Points:
    """Lines of uneven points over hills and a wall, with a hole in them and a bay in their outline."""
    generator = np.random.default_rng(seed)
    x, y = generator.uniform(0, 120, 3000), np.round(generator.uniform(0, 70, 3000) / 2) * 2
    y += generator.normal(0, 0.2, len(y))
    seen = (np.hypot(x - 50, y - 30) > 7) & ~((x > 90) & (np.abs(y - 50) < 6))
    x, y = x[seen], y[seen]
    z = 3 * np.sin(x / 15) * np.cos(y / 11) + 6.0 * (x > 77)
    middle = np.column_stack([x, np.full(len(x), 35.0), np.full(len(x), 60.0)])
    return seen_points(np.column_stack([x, y, z]), middle)


@pytest.mark.parametrize("turn", [0.0, 0.7])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_map_in_windows_is_the_map_of_all_points(seed, turn, monkeypatch):
    """The same cells, from the same points: triangles of a window that farther points forbid are not among them."""
    points = rough_survey(seed)
    cos, sin = np.cos(turn), np.sin(turn)
    points.position_m[:, :2] = points.position_m[:, :2] @ np.array([[cos, sin], [-sin, cos]])
    low, high = points.position_m[:, :2].min(axis=0), points.position_m[:, :2].max(axis=0)
    grid = Grid.covering(*low, *high, 1.0)
    whole = grid_points(points, grid, 2.5, SHADOW_RAD)
    monkeypatch.setattr(gridding, "MAX_POINTS", 200)
    assert len(windows_of(grid, points.position_m[:, :2], 200, 4 * 3 * 2.5)) >= 4
    parts = grid_points(points, grid, 2.5, SHADOW_RAD)
    np.testing.assert_array_equal(parts.dem.filled, whole.dem.filled)
    np.testing.assert_allclose(parts.dem.height_m, whole.dem.height_m, atol=1e-12)
    here, there = np.argsort(parts.cell), np.argsort(whole.cell)
    np.testing.assert_array_equal(np.sort(parts.corner[here]), np.sort(whole.corner[there]))
    assert 0.35 < whole.dem.filled.mean() < 0.95


def test_what_farther_points_forbid_is_not_filled(monkeypatch):
    """A shallow notch in an outline, closed by a thin triangle alone; a point 12 m beyond lies in its wide circle."""
    ground = np.random.default_rng(1).uniform([0, -60], [60, -1], (900, 2))
    edge = np.column_stack([np.arange(0.0, 61.0), np.full(61, -0.4)])
    edge = edge[(edge[:, 0] < 20) | (edge[:, 0] > 26)]
    notch = np.array([[20.0, 0.0], [26.0, 0.0], [23.0, -0.6]])
    beyond = np.random.default_rng(2).uniform([0, 14], [60, 80], (960, 2))
    place = np.concatenate([ground, edge, notch, beyond, [[23.0, 11.5], [5.0, 1.2]], ground[:30] * [0.2, 0] + [0, 1.2]])
    points = rough_survey(1).rows(np.arange(len(place)))
    points.position_m[:, :2], points.position_m[:, 2] = place, 0.0
    grid = Grid.covering(0.0, -60.0, 60.0, 80.0, 0.25)
    whole = grid_points(points, grid, 2.2, SHADOW_RAD)
    monkeypatch.setattr(gridding, "MAX_POINTS", len(place) - 1)
    low, high = windows_of(grid, place, len(place) - 1, 4 * 3 * 2.2)
    parts = grid_points(points, grid, 2.2, SHADOW_RAD)
    assert 0.0 < low.high_m[1] < 4.9 < high.high_m[1]
    np.testing.assert_array_equal(parts.dem.filled, whole.dem.filled)
