"""Walls of meshes: found where faces are steep and high, and as near as geometry says."""

import numpy as np
import pytest
import trimesh

from sionna_radar.accuracy.illumination import walls_on
from sionna_radar.foundation.raster import Grid
from sionna_radar.scene.footprints import Box, build_box
from sionna_radar.scene.model import Surface
from worlds import make_scene, make_surface

GRID = Grid(west_m=-40.0, south_m=-40.0, spacing_m=1.0, columns=81, rows=81)


@pytest.mark.parametrize(("height_m", "walls"), [(6.0, True), (0.5, False)])
def test_a_box_s_walls_are_those_of_its_outline(height_m, walls):
    """The same box once as a building of the scenario, once as any mesh of a city."""
    box = Box(position_m=(3.0, -5.0), size_m=(20.0, 12.0, height_m), heading_rad=np.deg2rad(30.0))
    ground = make_surface(lambda x, y: 0 * x)
    mesh = build_box(box, 0, lambda point: np.zeros(len(point)))
    city = walls_on(GRID, make_scene(ground, mesh), ())
    assert bool(city) is walls
    if not walls:
        return
    reach = np.full(len(GRID.centres_m), 3.0)
    exact = walls_on(GRID, make_scene(ground, mesh), (box,))
    assert len(exact.foot_m) == 0
    differing = city.near(GRID.centres_m, reach) != exact.near(GRID.centres_m, reach)
    assert exact.near(GRID.centres_m, reach).sum() > 300
    # Points every half a cell along the wall miss the distance by a centimetre at most.
    assert differing.mean() < 0.002


@pytest.mark.parametrize(("slope_deg", "walls"), [(45.0, False), (55.0, False), (65.0, True)])
def test_ground_is_no_wall_unless_no_soil_lies_so_steep(slope_deg, walls):
    rise = np.tan(np.deg2rad(slope_deg))
    ramp = make_surface(lambda x, y: rise * np.clip(x, 0.0, 10.0), size_m=100.0)
    assert bool(walls_on(GRID, make_scene(ramp), ())) is walls


def test_walls_beyond_the_map_are_none():
    far = Box(position_m=(200.0, 0.0), size_m=(20.0, 12.0, 6.0))
    mesh = build_box(far, 0, lambda point: np.zeros(len(point)))
    assert not walls_on(GRID, make_scene(make_surface(lambda x, y: 0 * x), mesh), ())


def test_the_walls_of_a_mesh_are_the_same_however_finely_they_are_divided():
    """A tower of triangles lower than any wall, and a kerb of the same that is none."""
    tower = trimesh.creation.box(bounds=[(-6, -4, 0), (6, 4, 9)])
    kerb = trimesh.creation.box(bounds=[(20, -20, 0), (22, 20, 0.6)])
    ground = make_surface(lambda x, y: 0 * x)
    found = []
    for size_m in (100.0, 0.7):
        fine = [mesh.subdivide_to_size(size_m) for mesh in (tower, kerb)]
        surfaces = [
            Surface(name="x", vertices_m=m.vertices, faces=m.faces, material="ground", divided=True) for m in fine
        ]
        found.append(walls_on(GRID, make_scene(ground, *surfaces), ()))
    reach = np.full(len(GRID.centres_m), 2.9)  # no cell is so far from a wall but for rounding
    near = [walls.near(GRID.centres_m, reach) for walls in found]
    assert near[0].sum() == 200  # whole metres so near to the sides of an oblong of 12 x 8 m
    assert np.count_nonzero(near[0] != near[1]) <= 4
    assert not np.any(near[1] & (GRID.centres_m[:, 0] > 15))
