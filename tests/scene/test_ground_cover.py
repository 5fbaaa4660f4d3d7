"""Splitting the ground by polygons and by a raster of classes."""

import tomllib
from functools import partial

import numpy as np
import pytest

from elevation_files import from_origin, write_heights
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.scenario import load_scenario, parse_scenario, to_toml
from sionna_radar.scene.build import build_world
from sionna_radar.scene.ground_cover import NO_CLASS, ClassRaster, classes_at
from sionna_radar.survey.preparation import prepare
from worlds import load_ground

EVERYWHERE = (-500.0, -500.0, 500.0, 500.0)
FOREST = {"materials.forest": {"terrain_class": "forest", "model": "constant_gamma"}}


write_classes = partial(write_heights, crs=None)


def area_of(surfaces, material) -> float:
    total = 0.0
    for surface in surfaces:
        if surface.material == material:
            a, b, c = np.moveaxis(surface.vertices_m[surface.faces], 1, 0)[:, :, :2]
            (ax, ay), (bx, by) = (b - a).T, (c - a).T
            total += np.abs(ax * by - ay * bx).sum() / 2
    return total


@pytest.mark.parametrize("name", ["hills", "jacksboro"])
def test_a_polygon_lies_over_any_terrain(name):
    corners = [[-40.0, -30.0], [60.0, -30.0], [60.0, 50.0]]
    changes = {"terrain.cover": [{"polygon_m": corners, "material": "forest"}], **FOREST}
    scenario = load_scenario(name, changes | ({"terrain.spacing_m": 5.0} if name == "jacksboro" else {}))
    surfaces = build_world(scenario, EVERYWHERE).scene.surfaces
    assert area_of(surfaces, "forest") == pytest.approx(100 * 80 / 2, rel=0.05)
    whole = build_world(load_scenario(name, {k: v for k, v in changes.items() if "cover" not in k}), EVERYWHERE)
    assert sum(len(s.faces) for s in surfaces) >= sum(len(s.faces) for s in whole.scene.surfaces)


def test_later_polygons_lie_over_earlier_ones():
    square = [[-50.0, -50.0], [50.0, -50.0], [50.0, 50.0], [-50.0, 50.0]]
    inner = [[x / 2, y / 2] for x, y in square]
    cover = [{"polygon_m": square, "material": "forest"}, {"polygon_m": inner, "material": "building"}]
    scenario = load_scenario("hills", {"terrain.kind": "flat", "terrain": {"kind": "flat", "cover": cover}, **FOREST})
    surfaces = build_world(scenario, EVERYWHERE).scene.surfaces
    assert area_of(surfaces, "building") == pytest.approx(2500)
    assert area_of(surfaces, "forest") == pytest.approx(7500)
    assert area_of(surfaces, "ground") == pytest.approx(300 * 300 - 10_000)


def test_a_class_raster_over_synthetic_ground(tmp_path):
    values = np.zeros((10, 10), dtype=np.uint8)
    values[:5] = 7  # the north
    path = write_classes(tmp_path / "classes.tif", values, from_origin(-100.0, 100.0, 20.0, 20.0))
    raster = {"path": str(path), "classes": {"7": "forest"}}
    scenario = load_scenario("hills", {"terrain": {"kind": "flat", "cover_raster": raster}, **FOREST})
    surfaces = build_world(scenario, EVERYWHERE).scene.surfaces
    assert area_of(surfaces, "forest") == pytest.approx(200 * 100)
    forest = next(s for s in surfaces if s.material == "forest")
    assert forest.vertices_m[forest.faces][:, :, 1].min() >= 0.0


def test_a_class_raster_in_degrees_over_real_ground(tmp_path):
    """Classes in longitude and latitude: everything west of a meridian is forest."""
    scenario = load_scenario("jacksboro")
    _, georeference = load_ground(scenario.terrain, EVERYWHERE)
    from pyproj import Transformer

    to_degrees = Transformer.from_crs(georeference.crs_wkt, "EPSG:4326", always_xy=True)
    east, north = georeference.origin_m[:2]
    longitude, latitude = to_degrees.transform(east, north)
    step = 1e-4
    values = np.full((400, 400), 3, dtype=np.int16)
    values[:, 200:] = 5
    corner = from_origin(longitude - 200 * step, latitude + 200 * step, step, step)
    path = write_classes(tmp_path / "classes.tif", values, corner, crs="EPSG:4326")
    point = np.random.default_rng(1).uniform(-400, 400, (500, 2))
    found = classes_at(ClassRaster(path=path, materials={3: "forest"}), point, georeference)
    there, _ = to_degrees.transform(east + point[:, 0], north + point[:, 1])
    np.testing.assert_array_equal(found, np.where(there < longitude, 3, 5))
    places = np.array([[0.0, 0.0], [9e4, 0.0]])
    far = classes_at(ClassRaster(path=path, materials={3: "forest"}), places, georeference)
    assert far[1] == NO_CLASS


def test_rasters_that_cannot_be_placed_are_refused(tmp_path):
    values = np.ones((4, 4), dtype=np.uint8)
    plain = write_classes(tmp_path / "plain.tif", values, from_origin(0.0, 40.0, 10.0, 10.0))
    placed = write_classes(tmp_path / "placed.tif", values, from_origin(0.0, 40.0, 10.0, 10.0), crs="EPSG:32616")
    far = write_classes(tmp_path / "far.tif", values, from_origin(9000.0, 40.0, 10.0, 10.0))
    (tmp_path / "text.tif").write_text("no raster")

    def build(name, path):
        raster = {"path": str(path), "classes": {"1": "forest"}}
        build_world(load_scenario(name, {"terrain.cover_raster": raster, **FOREST}), EVERYWHERE)

    for name, path, error, words in (
        ("hills", placed, ScenarioError, "terrain.cover_raster.path: .*remove the"),
        ("jacksboro", plain, ScenarioError, "terrain.cover_raster.path: .*no CRS"),
        ("hills", far, InputFileError, "does not overlap the terrain"),
        ("hills", tmp_path / "text.tif", InputFileError, "cannot be read"),
        ("hills", tmp_path / "absent.tif", InputFileError, "absent.tif"),
    ):
        with pytest.raises(error, match=words):
            build(name, path)


def test_a_polygon_beside_the_terrain_is_refused():
    cover = [{"polygon_m": [[900.0, 900.0], [910.0, 900.0], [910.0, 910.0]], "material": "building"}]
    with pytest.raises(ScenarioError, match=r"terrain\.cover\.0\.polygon_m"):
        prepare(load_scenario("hills", {"terrain.cover": cover}))


def test_cover_is_checked_and_survives_a_round_trip(tmp_path):
    path = write_classes(tmp_path / "c.tif", np.ones((4, 4), np.uint8), from_origin(-20.0, 20.0, 10.0, 10.0))
    toml = f"""
    terrain = {{kind = "hills", cover_raster = {{path = "{path.name}", classes = {{"1" = "building"}}}}}}
    platform = {{altitude_m = 50.0, speed_mps = 10.0}}
    radar = {{snr_db = 30.0}}
    """
    (tmp_path / "scenario.toml").write_text(toml)
    scenario = load_scenario(tmp_path / "scenario.toml")
    assert scenario.terrain.cover_raster.path == path
    assert parse_scenario(tomllib.loads(to_toml(scenario))) == scenario
    for key, value, words in (
        ("terrain.cover_raster.classes", {"x": "building"}, r"terrain\.cover_raster\.classes\.x"),
        ("terrain.cover_raster.classes", {"1": "nothing"}, r"terrain\.cover_raster\.classes\.1: .*not defined"),
        ("terrain.cover_raster.classes", {}, r"terrain\.cover_raster\.classes: empty"),
        ("terrain.cover", [{"polygon_m": [[0.0, 0.0]] * 2, "material": "building"}], r"terrain\.cover\.0\.polygon_m"),
        (
            "terrain.cover",
            [{"polygon_m": [[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]], "material": "moss"}],
            r"terrain\.cover\.0\.material",
        ),
    ):
        with pytest.raises(ScenarioError, match=words):
            load_scenario(tmp_path / "scenario.toml", {key: value})
