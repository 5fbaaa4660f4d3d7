"""Rays against ground on a grid, beside the same triangles in Mitsuba."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.scene.model import Surface, mesh_of
from sionna_radar.scene.raycast import RayCaster

RAYS = 20_000


@pytest.fixture(scope="module")
def ground() -> Raster:
    random = np.random.default_rng(1)
    grid = Grid(west_m=-40.0, south_m=-30.0, spacing_m=0.5, columns=161, rows=121)
    rough, hills = (gaussian_filter(random.normal(size=grid.shape), width) for width in (3, 15))
    return Raster(grid=grid, height_m=8 * rough + 60 * hills)


@pytest.fixture(scope="module")
def casters(ground):
    return of(ground)


def of(ground: Raster) -> tuple[RayCaster, RayCaster]:
    """Return casters against a mesh, and against the same ground by its heights."""
    vertices, faces = mesh_of(ground)
    mesh = Surface(name="ground", vertices_m=vertices, faces=faces, material="ground")
    return RayCaster([mesh]), RayCaster([replace(mesh, relief=ground)])


def rays(ground: Raster, up: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(2)
    low, high = ground.height_m.min(), ground.height_m.max()
    above = random.uniform(0.1, 40.0, RAYS)
    origin = np.column_stack([random.uniform(-50, 50, RAYS), random.uniform(-40, 40, RAYS), above])
    origin[:, 2] = high + above if up < 0 else low - above
    direction = random.normal(size=(RAYS, 3))
    direction[:, 2] = up * np.abs(direction[:, 2]) * random.uniform(0.05, 2.0, RAYS)
    return origin, direction / np.linalg.norm(direction, axis=1, keepdims=True)


@pytest.mark.parametrize("up", [-1, 1])
def test_rays_from_above_and_below_hit_the_same_triangles(ground, casters, up):
    mesh, relief = (caster.cast(*rays(ground, up)) for caster in casters)
    np.testing.assert_array_equal(relief.hit, mesh.hit)
    assert 0.2 < mesh.hit.mean() < 0.8
    hit = mesh.hit
    np.testing.assert_allclose(relief.distance_m[hit], mesh.distance_m[hit], atol=2e-3)
    same = relief.face[hit] == mesh.face[hit]
    assert same.mean() > 0.999  # those that differ meet the edge between two
    np.testing.assert_allclose(relief.cosine[hit][same], mesh.cosine[hit][same], atol=1e-5)


@pytest.mark.parametrize(("steep", "hidden"), [(1.0, 0.1), (0.1, 0.005)])
def test_places_are_hidden_alike(ground, steep, hidden):
    ground = Raster(grid=ground.grid, height_m=steep * ground.height_m)
    casters = of(ground)
    origin, _ = rays(ground, -1)
    random = np.random.default_rng(3)
    vertices, faces = mesh_of(ground)
    corner = vertices[faces[random.integers(0, len(faces), RAYS)]]
    point = np.einsum("nk,nki->ni", random.dirichlet([1, 1, 1], RAYS), corner)
    mesh, relief = (caster.hides(origin, np.arange(RAYS), point, 1e-4) for caster in casters)
    assert np.mean(mesh != relief) < 1e-3  # at the very edge of a shadow, in single precision
    assert hidden < mesh.mean() < 0.9


def test_rays_along_the_lines_of_the_grid_slip_through_none(ground, casters):
    """Mitsuba lets some of these pass between two triangles; the true distance is where the line meets the heights."""
    for direction in ([1.0, 0.0, -1.0], [-1.0, -6e-17, -1.0], [6e-17, 1.0, -1.0], [0.0, -1.0, -2.0], [1.0, 1.0, -1.0]):
        away = np.array(direction) / np.linalg.norm(direction)
        place = np.arange(-20.0, 20.0, 0.5)
        origin = np.column_stack([place, place[::-1] / 2, np.full(len(place), 30.0)])
        hits = casters[1].cast(origin, np.tile(away, (len(origin), 1)))
        inside = hits.hit
        assert inside.mean() > 0.2
        foot = origin + np.where(inside, hits.distance_m, 0.0)[:, None] * away
        np.testing.assert_allclose(foot[inside, 2], casters[1].from_above(foot[inside, :2], 60.0), atol=1e-6)
        # None passed under the ground before it was found.
        for share in np.linspace(0.0, 0.999, 50):
            way = origin[inside] + share * hits.distance_m[inside, None] * away
            above = way[:, 2] - ground.at(way[:, :2])  # bilinear, so not quite that of the triangles
            assert np.all(above[np.isfinite(above)] > -0.3)


def test_a_wall_on_the_ground_is_met_too(ground, casters):
    wall = Surface(
        name="wall",
        vertices_m=np.array([[0.0, -20.0, -30.0], [0.0, 20.0, -30.0], [0.0, 20.0, 30.0], [0.0, -20.0, 30.0]]),
        faces=np.array([[0, 1, 2], [0, 2, 3]]),
        material="ground",
    )
    surfaces = casters[0]._surfaces[0], casters[1]._surfaces[0]
    both = [RayCaster([surface, wall]).cast(*rays(ground, -1)) for surface in surfaces]
    np.testing.assert_array_equal(both[0].surface, both[1].surface)
    assert np.count_nonzero(both[0].surface == 1) > 100


def test_the_mesh_of_a_whole_raster_has_two_triangles_for_every_four_cells(ground):
    vertices, faces = mesh_of(ground)
    rows, columns = ground.grid.shape
    expected = [
        triangle
        for a in (row * columns + column for row in range(rows - 1) for column in range(columns - 1))
        for triangle in ((a, a + 1, a + columns + 1), (a, a + columns + 1, a + columns))
    ]
    np.testing.assert_array_equal(faces, expected)
    np.testing.assert_array_equal(vertices, np.column_stack([ground.grid.centres_m, ground.height_m.ravel()]))
