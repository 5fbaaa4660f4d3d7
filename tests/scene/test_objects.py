"""Meshes as ground and as objects: where they stand, how large, of what, and what lies under what."""

import numpy as np
import pytest
import trimesh
from pyproj import Transformer

from elevation_files import UTM, from_origin, write_heights
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.raster import Grid
from sionna_radar.scenario import parse_scenario
from sionna_radar.scenario.objects import MeshObject
from sionna_radar.scene import objects
from sionna_radar.scene.build import build_world
from sionna_radar.scene.ground_cover import overhang
from sionna_radar.scene.mesh_files.reader import read_mesh
from sionna_radar.scene.terrains.build import map_frame
from sionna_radar.survey.map_positions import in_local_frame

WINDOW = (-500.0, -500.0, 500.0, 500.0)
FLAT = {"kind": "flat", "size_m": [200.0, 200.0]}
HILLS = {"kind": "hills", "size_m": [120.0, 120.0], "spacing_m": 2.0, "filter_sigma_m": 15.0}
FOREST = {"forest": {"model": "constant_gamma", "gamma_db": -12.0}}


def scenario(terrain=None, **tables):
    platform = {"altitude_m": 50.0, "speed_mps": 10.0}
    return parse_scenario({"terrain": terrain or FLAT, "platform": platform, "radar": {"snr_db": 30.0}} | tables)


def build(terrain=None, **tables):
    return build_world(in_local_frame(scenario(terrain, **tables)), WINDOW)


def write(path, *boxes):
    """Write boxes, each given by its lowest and highest corner."""
    made = [trimesh.creation.box(bounds=np.array(b, dtype=float)) for b in boxes]
    trimesh.util.concatenate(made).export(path)
    return str(path)


def span(*surfaces):
    places = np.concatenate([s.vertices_m for s in surfaces])
    return np.array([places.min(axis=0), places.max(axis=0)])


@pytest.mark.parametrize(
    ("keys", "lowest", "highest"),
    [
        ({}, [10, 20, 0], [12, 23, 4]),
        ({"units": "ft"}, [10, 20, 0], [10 + 2 * 0.3048, 20 + 3 * 0.3048, 4 * 0.3048]),
        ({"units": "mm", "scale": 1000.0}, [10, 20, 0], [12, 23, 4]),
        ({"heading_deg": 90.0}, [10, 18, 0], [13, 20, 4]),  # the file's north points east, its east south
        ({"up": "y"}, [10, 15, 0], [12, 19, 3]),  # the file's y points up, its z south
        ({"on_ground": False, "position_m": [10.0, 20.0, 5.0]}, [10, 20, 6], [12, 23, 10]),
    ],
)
def test_an_object_stands_where_its_keys_say(keys, lowest, highest, tmp_path):
    path = write(tmp_path / "box.ply", [(0, 0, 1), (2, 3, 5)])
    built = build(objects=[{"path": path, "position_m": [10.0, 20.0], **keys}])
    np.testing.assert_allclose(span(built.scene.surfaces[-1]), [lowest, highest], atol=1e-9)
    assert built.scene.surfaces[-1].material == "building"


def test_copies_of_one_file_are_read_once(tmp_path, monkeypatch):
    path = write(tmp_path / "tree.ply", [(-1, -1, 0), (1, 1, 5)])
    read = []
    monkeypatch.setattr(objects, "read_mesh", lambda *given: read.append(given) or read_mesh(*given))
    wood = [{"path": path, "position_m": [5.0 * i, 0.0]} for i in range(4)]
    built = build(objects=[*wood, {"path": path, "position_m": [0.0, 20.0], "scale": 2.0}])
    assert len(read) == 2
    np.testing.assert_allclose([span(s)[1, 0] for s in built.scene.surfaces[1:]], [1, 6, 11, 16, 2])


def test_an_object_on_a_slope_stands_on_the_lowest_ground_in_its_outline(tmp_path):
    path = write(tmp_path / "box.stl", [(-10, -6, 0), (10, 6, 3)])
    built = build(HILLS, objects=[{"path": path, "position_m": [5.0, 9.0]}])
    x, y = np.meshgrid(np.linspace(-5, 15, 41), np.linspace(3, 15, 41))
    lowest = built.ground_m(np.column_stack([x.ravel(), y.ravel()])).min()
    assert span(built.scene.surfaces[-1])[0, 2] == pytest.approx(lowest, abs=0.02)


def test_heights_without_ground_are_those_of_the_terrain(tmp_path):
    """A raster's local heights count from a base; an object's from the raster's datum."""
    level = np.full((40, 40), 1234.0, dtype="float32")
    write_heights(tmp_path / "dem.tif", level, from_origin(450_000, 5_000_000, 5, 5))
    box = write(tmp_path / "box.ply", [(0, 0, 0), (2, 3, 4)])
    thing = {"path": box, "position_m": [0.0, 0.0, 1250.0], "on_ground": False}
    built = build({"kind": "raster", "path": str(tmp_path / "dem.tif")}, objects=[thing])
    assert span(built.scene.surfaces[-1])[0, 2] + built.scene.georeference.origin_m[2] == pytest.approx(1250.0)


def test_an_object_given_in_map_coordinates_is_moved(tmp_path):
    box = write(tmp_path / "box.ply", [(-1, -1, 0), (1, 1, 2)])
    terrain = FLAT | {"centre_lonlat_deg": [9.0, 47.0]}
    built = build(terrain, coordinates="lonlat", objects=[{"path": box, "position_m": [9.0005, 47.0]}])
    utm = Transformer.from_crs(4326, UTM, always_xy=True)
    (east, north), (x0, y0) = utm.transform(9.0005, 47.0), utm.transform(9.0, 47.0)
    np.testing.assert_allclose(span(built.scene.surfaces[-1])[0, :2], [east - x0 - 1, north - y0 - 1], atol=1e-6)


def test_materials_go_by_the_mesh_s_own_names(tmp_path):
    (tmp_path / "two.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl tin\nf 1 3 2\nf 1 2 4\nusemtl oak\nf 2 3 4\nf 1 4 3\n"
    )
    thing = {"path": str(tmp_path / "two.obj"), "position_m": [0.0, 0.0]}
    built = build(objects=[thing | {"material": "forest", "materials": {"tin": "building"}}], materials=FOREST)
    assert [(s.material, len(s.faces), s.two_sided) for s in built.scene.surfaces[1:]] == [
        ("building", 2, False),
        ("forest", 2, False),
    ]
    with pytest.raises(ScenarioError, match=r"objects.0.materials: the mesh has no 'zinc'; it has 'oak', 'tin'"):
        build(objects=[thing | {"materials": {"zinc": "building"}}])
    with pytest.raises(ScenarioError, match=r"objects.0.materials.tin: 'gold' is not defined"):
        build(objects=[thing | {"materials": {"tin": "gold"}}])


@pytest.mark.parametrize(
    ("keys", "error", "message"),
    [
        ({"position_m": [1.0, 2.0, 3.0]}, ScenarioError, "has a third number, the height"),
        ({"position_m": [1.0, 2.0], "on_ground": False}, ScenarioError, "needs a third number"),
        ({"position_m": [99.5, 0.0]}, ScenarioError, "extends beyond the terrain"),
        ({"position_m": [1.0, 2.0], "units": "km", "scale": 50.0}, InputFileError, "200 km across in units = 'km'"),
        ({"position_m": [1.0, 2.0], "units": "mm", "scale": 0.1}, InputFileError, "set units = 'km' or a scale"),
        ({"position_m": [1.0, 2e9, 3.0], "on_ground": False}, ScenarioError, "2,000,000 km from the local origin"),
    ],
)
def test_an_object_that_cannot_stand_there_says_why(keys, error, message, tmp_path):
    path = write(tmp_path / "box.ply", [(0, 0, 1), (2, 3, 5)])
    with pytest.raises(error, match=message):
        build(objects=[{"path": path, **keys}])


@pytest.mark.parametrize("heading_deg", [0.0, 90.0])
def test_a_mesh_far_from_its_own_origin_stands_by_the_middle_of_its_box(heading_deg, tmp_path):
    path = write(tmp_path / "far.ply", [(5000, -7000, 40), (5004, -6994, 45)])
    thing = {"path": path, "position_m": [10.0, 20.0], "heading_deg": heading_deg}
    with pytest.raises(ScenarioError, match=r"x = .* extends beyond .* 8,601 m from the middle of its box: set"):
        build(objects=[thing])
    half = np.array([2.0, 3.0] if heading_deg == 0 else [3.0, 2.0])
    built = build(objects=[thing | {"centre": "box"}])
    low, high = span(*built.scene.surfaces[1:])
    np.testing.assert_allclose(
        [low, high], [[10 - half[0], 20 - half[1], 0], [10 + half[0], 20 + half[1], 5]], atol=1e-3
    )
    raised = build(objects=[thing | {"centre": "box", "on_ground": False, "position_m": [10.0, 20.0, 7.0]}])
    assert span(*raised.scene.surfaces[1:])[:, 2] == pytest.approx([7.0, 12.0], abs=1e-3)
    west, east = 10 - half[0], 10 + half[0]
    said = objects.placed_boxes(built.scene.surfaces)
    assert list(said) == ["objects.0"]
    assert said["objects.0"].startswith(f"x = {west:.1f} to {east:.1f} m")
    ground = build({"kind": "mesh", "path": path, "centre": "box", "heading_deg": heading_deg})
    np.testing.assert_allclose(span(*ground.scene.surfaces), [[*-half, 0], [*half, 5]], atol=1e-3)


@pytest.fixture
def site(tmp_path):
    """Ground with a bottom plate at -5 m, a bridge over it from 4 to 5 m, a house, and a ball on a thin post."""
    ball = trimesh.creation.icosphere(radius=3.0, subdivisions=3)
    ball.apply_translation([-20, 20, 12])
    made = [
        trimesh.creation.box(bounds=[(-50, -50, -5), (50, 50, 0)]),
        trimesh.creation.box(bounds=[(0, -5, 4), (30, 5, 5)]),
        trimesh.creation.box(bounds=[(-40, -40, 0), (-30, -20, 8)]),
        ball,
    ]
    trimesh.util.concatenate(made).export(tmp_path / "site.ply")
    return str(tmp_path / "site.ply")


def test_the_ground_of_a_mesh_is_its_lowest_top(site):
    built = build({"kind": "mesh", "path": site})
    place = np.array([[10.0, 0.0], [10.0, 20.0], [-35.0, -30.0], [-20.0, 20.0], [60.0, 0.0]])
    # Under the bridge and the ball the ground counts; inside the house, too, whose walls enclose it.
    np.testing.assert_allclose(built.ground_m(place), [0, 0, 0, 0, np.nan], atol=1e-5)
    np.testing.assert_allclose(built.caster.from_above(place, 50.0), [5, 0, 8, 15, np.nan], atol=0.01)


def test_what_stands_on_a_mesh_is_seen_and_is_no_ground(site):
    built = build({"kind": "mesh", "path": site}, buildings=[{"position_m": [20.0, 30.0], "size_m": [8.0, 8.0, 6.0]}])
    place = np.array([[20.0, 30.0], [10.0, 20.0]])
    np.testing.assert_allclose(built.caster.from_above(place, 50.0), [6, 0], atol=1e-4)
    np.testing.assert_allclose(built.ground_m(place), [0, 0], atol=1e-5)


def test_overhanging_cells_are_those_with_air_under_them(site):
    """The bridge's 30 x 10 and the ball's pi 3^2 cells, and not the house's 200, nor the ground over its plate."""
    built = build({"kind": "mesh", "path": site})
    assert built.may_overhang
    grid = Grid(west_m=-49.5, south_m=-49.5, spacing_m=1.0, columns=100, rows=100)
    found = overhang(built.caster, grid, -20.0)
    ball = np.count_nonzero(np.hypot(*(grid.centres_m - [-20, 20]).T) < 2.97)
    assert found.cells == pytest.approx(300 + ball, abs=3)
    assert found.share == pytest.approx(found.cells / 10_000)
    bridge, sphere = found.places
    west, south, east, north = bridge.extent_m
    assert sorted((east - west, north - south)) == pytest.approx([10.0, 30.0], abs=1.01)
    assert sphere.extent_m == pytest.approx((-23.0, 17.0, -17.0, 23.0), abs=1.01)
    assert bridge.cells + sphere.cells == found.cells


def test_a_house_on_a_slope_overhangs_nothing(tmp_path):
    path = write(tmp_path / "box.ply", [(-10, -6, 0), (10, 6, 12)])
    built = build(HILLS, objects=[{"path": path, "position_m": [5.0, 9.0]}])
    grid = Grid(west_m=-40.0, south_m=-40.0, spacing_m=1.0, columns=81, rows=81)
    assert overhang(built.caster, grid, -20.0).cells == 0


def test_covers_lie_on_the_faces_of_the_ground_s_own_material(tmp_path):
    lawn = trimesh.creation.box(bounds=[(-50, -50, -1), (50, 50, 0)]).subdivide().subdivide().subdivide().subdivide()
    text = trimesh.exchange.obj.export_obj(lawn)
    shed = "usemtl shed\no shed\nv -10 -10 0\nv 10 -10 0\nv 0 10 9\nf -3 -2 -1\n"
    (tmp_path / "site.obj").write_text(f"usemtl lawn\n{text}\n{shed}")
    half = {"polygon_m": [[-60, -60], [0, -60], [0, 60], [-60, 60]], "material": "forest"}
    terrain = {"kind": "mesh", "path": str(tmp_path / "site.obj"), "materials": {"shed": "building"}, "cover": [half]}
    surfaces = build(terrain, materials=FOREST).scene.surfaces
    assert sorted({s.material for s in surfaces}) == ["building", "forest", "ground"]
    forest = next(s for s in surfaces if s.material == "forest")
    assert forest.vertices_m[forest.faces].mean(axis=1)[:, 0].max() < 0
    assert sum(len(s.faces) for s in surfaces if s.material == "building") == 1


def test_map_coordinates_keep_their_millimetres(tmp_path):
    """Float32 has steps of half a metre at a northing of five million metres."""
    corner = np.array([[500_000.001, 5_200_000.002, 410.003], [500_100.011, 5_200_000.0, 411.0]])
    corner = np.concatenate([corner, [[500_050.0, 5_200_090.507, 412.0]]])
    rows = "\n".join("v {:.4f} {:.4f} {:.4f}".format(*c) for c in corner)
    (tmp_path / "site.obj").write_text(f"{rows}\nf 1 2 3\n")
    terrain = {"kind": "mesh", "path": str(tmp_path / "site.obj"), "crs": UTM}
    built = build(terrain)
    place = built.scene.georeference
    np.testing.assert_allclose(built.scene.surfaces[0].vertices_m + place.origin_m, corner, atol=1e-6)
    assert np.abs(built.scene.surfaces[0].vertices_m[:, :2]).max() < 100
    frame = map_frame(scenario(terrain).terrain)
    assert (frame.crs.to_epsg(), *frame.origin_m) == (32632, *place.origin_m[:2])


def test_a_mesh_of_a_projection_that_stretches_is_moved_into_its_zone(tmp_path):
    lon, lat = np.array([9.0, 9.001, 9.0]), np.array([47.0, 47.0, 47.001])
    x, y = Transformer.from_crs(4326, 3857, always_xy=True).transform(lon, lat)
    rows = "\n".join(f"v {a:.4f} {b:.4f} 7" for a, b in zip(x, y, strict=True))
    (tmp_path / "site.obj").write_text(f"{rows}\nf 1 2 3\n")
    built = build({"kind": "mesh", "path": str(tmp_path / "site.obj"), "crs": "EPSG:3857"})
    east, north = Transformer.from_crs(4326, UTM, always_xy=True).transform(lon, lat)
    found = built.scene.surfaces[0].vertices_m[:, :2] + built.scene.georeference.origin_m[:2]
    np.testing.assert_allclose(found, np.column_stack([east, north]), atol=1e-3)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"crs": "EPSG:4326"}, r"terrain.crs: 'WGS 84' is not projected"),
        ({"crs": "nowhere"}, r"terrain.crs: 'nowhere' is not a coordinate reference system"),
        ({"crs": UTM, "position_m": [1.0, 0.0, 0.0]}, r"terrain.position_m: has no effect on a mesh with a CRS"),
        ({"crs": UTM, "centre": "box"}, r"terrain.centre: has no effect on a mesh with a CRS"),
        ({"position_m": [4e5, 5e6, 0.0]}, r"terrain.position_m: .* lies up to 5,000 km .* give terrain.crs"),
    ],
)
def test_a_mesh_that_lies_nowhere_says_why(keys, message, site):
    with pytest.raises(ScenarioError, match=message):
        build({"kind": "mesh", "path": site, **keys})


def test_a_scene_of_sionna_read_as_a_mesh_is_that_city():
    import sionna.rt

    path = sionna.rt.scene.simple_street_canyon_with_cars
    from sionna_radar.scene.model import Surface
    from sionna_radar.scene.raycast import RayCaster

    theirs = sionna.rt.load_scene(path)
    surfaces = [
        Surface(
            name=name,
            vertices_m=thing.mi_mesh.vertex_positions_buffer().numpy().reshape(-1, 3).astype(np.float64),
            faces=thing.mi_mesh.faces_buffer().numpy().reshape(-1, 3).astype(np.int64),
            material="ground",
        )
        for name, thing in theirs.objects.items()
    ]
    built = build({"kind": "mesh", "path": path, "materials": {"glass": "building"}})
    place = np.random.default_rng(1).uniform(-60, 60, (5000, 2))
    np.testing.assert_allclose(
        built.caster.from_above(place, 100.0), RayCaster(surfaces).from_above(place, 100.0), atol=1e-4
    )
    assert sum(len(s.faces) for s in built.scene.surfaces) == sum(len(s.faces) for s in surfaces)


def test_a_table_of_materials_may_be_the_material():
    given = {"path": "pylon.glb", "position_m": (0.0, 0.0)}
    assert MeshObject(**given, material={"steel": "metal"}) == MeshObject(**given, materials={"steel": "metal"})
    assert MeshObject(**given, material="metal").materials == {}
