"""Delaunay triangles piece by piece, against those of the whole."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from sionna_radar.mapping.linear import triangulation
from sionna_radar.mapping.linear.triangulation import delaunay_triangles

RANDOM = np.random.default_rng(5)
COUNT = 6000


def lines(across: int, apart_m: float) -> np.ndarray:
    """A whisk-broom's points: arcs, one beside the other."""
    angle, line = np.meshgrid(np.linspace(-0.9, 0.9, across), np.arange(COUNT // across))
    range_m = 70 + RANDOM.normal(0, 0.05, angle.shape)
    return np.stack([range_m * np.cos(angle) + apart_m * line, range_m * np.sin(angle)], axis=-1).reshape(-1, 2)


def with_holes() -> np.ndarray:
    place = RANDOM.uniform(0, 100, (2 * COUNT, 2))
    near = [np.hypot(*(place - middle).T) < radius for middle, radius in (((50, 50), 20), ((20, 80), 8), ((0, 0), 30))]
    return place[~np.any(near, axis=0)]


CLOUDS = {
    "even": RANDOM.uniform(0, 100, (COUNT, 2)),
    "long": RANDOM.uniform(0, 1, (COUNT, 2)) * [1000.0, 1.0],
    "arcs": lines(60, 1.0),
    "arcs far apart": lines(600, 5.0),
    "clusters": np.concatenate([RANDOM.normal(middle, 1, (600, 2)) for middle in RANDOM.uniform(0, 100, (10, 2))]),
    "holes": with_holes(),
    "two clouds": np.concatenate([RANDOM.normal(middle, 1, (COUNT // 2, 2)) for middle in (0, 500)]),
}


def each(triangles: np.ndarray) -> list[tuple[int, ...]]:
    return sorted(map(tuple, np.sort(triangles, axis=1).tolist()))


@pytest.mark.parametrize("name", CLOUDS)
def test_all_triangles_are_there_once(monkeypatch, name):
    monkeypatch.setattr(triangulation, "PIECE_POINTS", 700)
    pieces = []
    whole = triangulation._piece
    monkeypatch.setattr(triangulation, "_piece", lambda *given: pieces.append(1) or whole(*given))
    assert each(delaunay_triangles(CLOUDS[name])) == each(Delaunay(CLOUDS[name]).simplices)
    assert len(pieces) >= 8


def test_triangles_between_points_of_a_grid_cover_it(monkeypatch):
    """Four points on a circle have two divisions, and pieces may choose different ones."""
    monkeypatch.setattr(triangulation, "PIECE_POINTS", 300)
    place = np.stack(np.meshgrid(np.arange(40.0), np.arange(40.0)), axis=-1).reshape(-1, 2)
    corner = place[delaunay_triangles(place)]
    inside = RANDOM.uniform(0.01, 38.99, (400, 2))
    b, c, p = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], inside[:, None] - corner[:, 0]
    area = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
    assert np.all(np.abs(area) <= 1 + 1e-9)
    with np.errstate(divide="ignore", invalid="ignore"):
        of_b = (p[..., 0] * c[:, 1] - p[..., 1] * c[:, 0]) / area
        of_c = (b[:, 0] * p[..., 1] - b[:, 1] * p[..., 0]) / area
    assert np.all(np.any((of_b >= 0) & (of_c >= 0) & (of_b + of_c <= 1), axis=1))


@pytest.mark.parametrize("place", [np.zeros((0, 2)), np.zeros((2, 2)), np.column_stack([np.arange(5000.0)] * 2)])
def test_points_on_one_line_have_none(monkeypatch, place):
    monkeypatch.setattr(triangulation, "PIECE_POINTS", 700)
    assert delaunay_triangles(place).shape == (0, 3)


def test_few_points_are_triangulated_as_ever():
    np.testing.assert_array_equal(delaunay_triangles(CLOUDS["even"]), Delaunay(CLOUDS["even"]).simplices)
