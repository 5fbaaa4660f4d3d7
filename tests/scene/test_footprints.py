"""Buildings from outlines: their shape, their heights, their place, and what is left out with a count."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from pyproj import Transformer

from sionna_radar.elevation.local_frame import frame_at
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.scenario import parse_scenario
from sionna_radar.scene.build import build_world
from sionna_radar.scene.footprints import OutlineFile, build_footprints, height_of
from vector_files import rectangle, write_by_gdal, write_geojson

WINDOW = (-200.0, -200.0, 200.0, 200.0)
PLACE = (9.0, 47.0)
FRAME = frame_at(*PLACE)


def level(place_m):
    return np.zeros(len(place_m))


def slope(place_m):
    return np.where(np.abs(place_m[:, 0]) > 150, np.nan, 100.0 + 0.1 * place_m[:, 0])


def footprints(path, ground=level, frame=None, window=WINDOW, **keys):
    """The buildings of one material, as a surface; None if there are none."""
    surfaces = build_footprints(OutlineFile(path=path, **({"height_m": 5.0} | keys)), 0, frame, window, ground)
    assert len(surfaces) < 2
    return surfaces[0] if surfaces else None


def solid(surface):
    """Return area of roofs and of walls, and the volume under the roofs down to the feet."""
    corner = surface.vertices_m[surface.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) / 2
    roof = normal[:, 2] > 1e-6
    assert not np.any(normal[:, 2] < -1e-6)
    height = corner[roof, 0, 2] - surface.vertices_m[:, 2].min()
    return normal[roof, 2].sum(), np.linalg.norm(normal[~roof], axis=1).sum(), (normal[roof, 2] * height).sum()


def test_a_courtyard_stays_open_and_walls_face_out(tmp_path):
    """Rings of either sense: the file's order does not matter."""
    rings = [rectangle(0, 0, 20, 10)[::-1], rectangle(5, 3, 9, 7)]
    surface = footprints(write_geojson(tmp_path / "a.geojson", [(rings, {})]))
    assert solid(surface) == (pytest.approx(200 - 16), pytest.approx(5 * (60 + 16)), pytest.approx(5 * 184))
    corner = surface.vertices_m[surface.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    walls = np.abs(normal[:, 2]) < 1e-6
    outside = corner[walls].mean(axis=1) + 1e-3 * normal[walls] / np.linalg.norm(normal[walls], axis=1)[:, None]
    plan = shapely.Polygon(rings[0], [rings[1]])
    assert not shapely.contains_xy(plan, *outside[:, :2].T).any()


def test_a_building_stands_on_the_lowest_ground_along_its_outline(tmp_path):
    surface = footprints(write_geojson(tmp_path / "a.json", [([rectangle(10, -5, 40, 5)], {})]), slope)
    assert surface.vertices_m[:, 2].min() == pytest.approx(101.0)
    assert surface.vertices_m[:, 2].max() == pytest.approx(106.0)


@pytest.mark.parametrize(
    ("text", "height"),
    [
        (7, 7.0), (7.5, 7.5), ("12", 12.0), ("12.5 m", 12.5), ("12,5", 12.5), ("40 ft", 12.192), ("40'", 12.192),
        ("7'6\"", 2.286), (" 3m ", 3.0), ("about 9", np.nan), (None, np.nan), ("", np.nan), (True, np.nan),
        ("9" * 200, np.nan), ("-3", np.nan),
    ],
)  # fmt: skip
def test_heights_are_read_as_maps_write_them(text, height):
    assert height_of(text) == pytest.approx(height, nan_ok=True)


def test_a_height_comes_from_its_attribute_then_the_storeys_then_the_number_for_all(tmp_path, caplog):
    given = [{"height": "8 m"}, {"height": "tall", "building:levels": "2"}, {"building:levels": 3}, {}, {"height": 9e9}]
    features = [([rectangle(20 * i, 0, 20 * i + 10, 10)], g) for i, g in enumerate(given)]
    path = write_geojson(tmp_path / "a.geojson", features)
    keys = {"height": "height", "levels": "building:levels", "level_height_m": 3.5}

    def roofs(**more):
        surface = footprints(path, **keys, **more)
        return [surface.vertices_m[surface.vertices_m[:, 0] // 20 == i, 2].max(initial=0.0) for i in range(5)]

    np.testing.assert_allclose(roofs(height_m=6.0), [8, 7, 10.5, 6, 0])
    assert "left out 1 without a height that a building can have" in caplog.text
    caplog.clear()
    np.testing.assert_allclose(roofs(height_m=None), [8, 7, 10.5, 0, 0])
    assert "left out 2 without a height" in caplog.text
    assert ", of 5" in caplog.text


@pytest.mark.parametrize("name", ["a.geojson", "a.gpkg", "a.shp", "utm.gpkg", "old.json"])
def test_outlines_are_moved_from_their_crs_to_the_ground_s(name, tmp_path):
    """A box of 30 x 20 m, 50 m east and 40 m south of the origin."""
    crs = "EPSG:25832" if name in ("utm.gpkg", "old.json") else "EPSG:4326"
    corner = np.array(rectangle(50, -60, 80, -40), dtype=float) + FRAME.origin_m
    plan = np.column_stack(Transformer.from_crs(FRAME.crs, crs, always_xy=True).transform(*corner.T))
    path = tmp_path / name
    if path.suffix in (".geojson", ".json"):
        named = {"crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}}
        write_geojson(path, [([plan.tolist()], {"height": 11})], **(named if name == "old.json" else {}))
    else:
        write_by_gdal(path, [(shapely.Polygon(plan), {"height": "11"})], crs)
    surface = footprints(path, frame=FRAME, height="height")
    low, high = surface.vertices_m.min(axis=0), surface.vertices_m.max(axis=0)
    np.testing.assert_allclose([low, high], [[50, -60, 0], [80, -40, 11]], atol=0.01)


def test_what_is_broken_or_elsewhere_is_repaired_or_left_out_with_its_count(tmp_path, caplog):
    bow_tie = [[[0, 0], [10, 10], [10, 0], [0, 10], [0, 0]]]
    pair = {"type": "MultiPolygon", "coordinates": [[rectangle(20, 0, 30, 10)], [rectangle(20, 20, 30, 30)]]}
    features = [
        (bow_tie, {}),
        (pair, {}),
        ({"type": "Point", "coordinates": [1, 2]}, {}),
        (None, {}),
        ([rectangle(145, 0, 155, 10)], {}),  # beyond the ground
        ([rectangle(900, 0, 910, 10)], {}),  # beyond the survey's reach: nothing is said of it
    ]
    surface = footprints(write_geojson(tmp_path / "a.geojson", features), slope)
    area, _, _ = solid(surface)
    assert area == pytest.approx(50 + 200)
    assert "left out 2 no polygons, 1 beyond the terrain, and repaired 1 outlines, of 5" in caplog.text


def test_none_within_reach_is_said_and_none_on_the_ground_is_refused(tmp_path, caplog):
    path = write_geojson(tmp_path / "a.geojson", [([rectangle(160, 0, 170, 10)], {})])
    with pytest.raises(ScenarioError, match=r"footprints.0.path: none of its 1 outlines stands on the terrain"):
        footprints(path, slope)
    assert footprints(path, window=(0.0, 0.0, 10.0, 10.0)) is None
    assert "has no polygon within the survey's reach" in caplog.text


@pytest.mark.parametrize(
    ("keys", "error", "message"),
    [
        ({"height": "hight"}, InputFileError, "no attribute 'hight'; it has height"),
        ({"layer": "roads"}, InputFileError, "no layer 'roads'; it has 'houses', 'sheds'"),
        ({}, InputFileError, "2 layers; name one as layer: 'houses', 'sheds'"),
        ({"layer": "sheds", "frame": None}, ScenarioError, "terrain is on no map; set terrain.centre_lonlat_deg"),
    ],
)
def test_a_file_that_needs_more_words_says_which(keys, error, message, tmp_path):
    shape = shapely.box(9.0, 47.0, 9.001, 47.001)
    path = write_by_gdal(tmp_path / "a.gpkg", [(shape, {"height": 3.0})], "EPSG:4326", layer="houses")
    write_by_gdal(path, [(shape, {"height": 3.0})], "EPSG:4326", layer="sheds", append=True)
    keys = ({"layer": "houses"} if "height" in keys else {}) | {"frame": FRAME} | keys
    with pytest.raises(error, match=message):
        footprints(path, **keys)


def test_a_layer_of_a_file_without_layers_is_refused(tmp_path):
    path = write_geojson(tmp_path / "a.geojson", [([rectangle(0, 0, 10, 10)], {})])
    with pytest.raises(
        ScenarioError, match=r"footprints\.0\.layer: GeoJSON has no layers, such as 'houses'; remove it"
    ):
        footprints(path, layer="houses")


def test_degrees_over_ground_on_no_map_are_noticed(tmp_path):
    path = write_geojson(tmp_path / "a.geojson", [([rectangle(9, 47, 9.0002, 47.0001)], {})])
    with pytest.raises(ScenarioError, match=r"seem to be in degrees; set terrain.centre_lonlat_deg"):
        footprints(path)


def test_ten_thousand_buildings_are_one_surface_with_one_look_at_the_ground(tmp_path):
    """One surface a file and one call for the ground, so that ten thousand take seconds."""
    west, south = (30 * k.ravel() for k in np.meshgrid(np.arange(100), np.arange(100)))
    shapes = shapely.box(west, south, west + 15, south + 10)
    shapes = shapely.transform(shapes, lambda place: place + FRAME.origin_m)
    features = [(shape, {"height": 3.0 + i % 5}) for i, shape in enumerate(shapes)]
    path = write_by_gdal(tmp_path / "town.gpkg", features, FRAME.crs.to_wkt())
    looked = []

    def ground(place_m):
        looked.append(len(place_m))
        return level(place_m)

    surface = footprints(path, ground, FRAME, (-10.0, -10.0, 4000.0, 4000.0), height="height")
    assert len(looked) == 1
    assert len(surface.faces) == 100_000  # 8 triangles of walls and 2 of the roof
    assert solid(surface)[2] == pytest.approx(150 * 5 * 10_000)


def test_a_scenario_stands_its_footprints_among_its_other_things(tmp_path):
    path = write_geojson(tmp_path / "a.geojson", [([rectangle(10, 10, 30, 20)], {})])
    tables = {
        "terrain": {"kind": "flat", "size_m": [200.0, 200.0]},
        "platform": {"altitude_m": 50.0, "speed_mps": 10.0},
        "radar": {"snr_db": 30.0},
        "footprints": [{"path": str(path), "height_m": 8.0}],
        "buildings": [{"position_m": [0.0, 0.0], "size_m": [4.0, 4.0, 4.0]}],
    }
    built = build_world(parse_scenario(tables), WINDOW)
    assert [s.name for s in built.scene.surfaces] == ["terrain-0", "footprints-0", "building-0"]
    seen = built.caster.from_above(np.array([[20.0, 15.0], [0.0, 0.0], [40.0, 15.0]]), 50.0)
    np.testing.assert_allclose(seen, [8, 4, 0], atol=1e-5)
    with pytest.raises(ScenarioError, match=r"footprints.0.material: 'tin' is not defined"):
        parse_scenario(tables | {"footprints": [{"path": "x.shp", "height_m": 1.0, "material": "tin"}]})
    with pytest.raises(ScenarioError, match=r"footprints.0.height_m: missing"):
        parse_scenario(tables | {"footprints": [{"path": "x.shp"}]})


def test_materials_come_from_an_attribute(tmp_path):
    """Values that no material is given for, and outlines without one, are of the material for all."""
    made_of = [{"building:material": name} for name in ("brick", "glass", "straw")] + [{}]
    boxes = [([rectangle(20 * k, 0, 20 * k + 10, 10)], made) for k, made in enumerate(made_of)]
    table = OutlineFile(
        path=write_geojson(tmp_path / "a.geojson", boxes),
        height_m=4.0,
        material_attribute="building:material",
        materials={"brick": "wall", "glass": "pane"},
    )
    surfaces = build_footprints(table, 0, None, WINDOW, level)
    west = {surface.material: surface.vertices_m[:, 0].min() for surface in surfaces}
    assert west == {"wall": 0.0, "pane": 20.0, "building": 40.0}
    assert len({surface.name for surface in surfaces}) == 3
    assert len(next(s for s in surfaces if s.material == "building").faces) == 2 * len(surfaces[0].faces)
    with pytest.raises(ScenarioError, match="no outline has 'wood' as building:material; there are 'brick'"):
        build_footprints(replace(table, materials={"wood": "wall"}), 0, None, WINDOW, level)
