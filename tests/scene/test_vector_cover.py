"""Land cover from polygons with a class."""

import numpy as np
import pytest

from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.scenario import parse_scenario
from sionna_radar.scene.build import build_world
from sionna_radar.scene.ground_cover import ClassPolygons, vector_classes_at
from vector_files import rectangle, write_geojson

CLASSES = {"wood": "forest", "7": "water"}
RNG = np.random.default_rng(1)


def materials(*names):
    return {name: {"model": "constant_gamma", "gamma_db": -10.0} for name in names}


@pytest.fixture
def plan(tmp_path):
    """A wood over the west, with a clearing; a pond in it; a parish over everything, of no class that is mapped."""
    features = [
        ([rectangle(-100, -100, 0, 100), rectangle(-60, 20, -40, 40)], {"use": "wood"}),
        ([rectangle(-30, -10, 20, 10)], {"use": 7.0}),
        ([rectangle(-20, -5, -10, 5)], {"use": "wood"}),
        ([rectangle(-100, -100, 100, 100)], {"use": "parish"}),
        ([rectangle(50, 50, 60, 60)], {"use": None}),
    ]
    return write_geojson(tmp_path / "use.geojson", features)


def expected(x, y):
    number = np.where(x < 0, 0, -1)
    number[(x > -60) & (x < -40) & (y > 20) & (y < 40)] = -1
    number[(x > -30) & (x < 20) & (np.abs(y) < 10)] = 1
    number[(x > -20) & (x < -10) & (np.abs(y) < 5)] = 0
    return number


def test_the_last_polygon_of_a_mapped_class_counts(plan):
    place = RNG.uniform(-99, 99, (20_000, 2))
    found = vector_classes_at(ClassPolygons(path=plan, attribute="use", materials=CLASSES), place, None)
    np.testing.assert_array_equal(found, expected(*place.T))


def test_a_scenario_lays_them_under_its_polygons(plan):
    cover = [{"polygon_m": [[-90, -90], [-70, -90], [-70, -70], [-90, -70]], "material": "field"}]
    terrain = {
        "kind": "flat",
        "size_m": [200.0, 200.0],
        "spacing_m": 2.0,
        "cover": cover,
        "cover_vector": {"path": str(plan), "attribute": "use", "classes": CLASSES},
    }
    tables = {
        "terrain": terrain,
        "materials": materials("forest", "water", "field"),
        "platform": {"altitude_m": 50.0, "speed_mps": 10.0},
        "radar": {"snr_db": 30.0},
    }
    built = build_world(parse_scenario(tables), (-500.0, -500.0, 500.0, 500.0))
    faces = {s.material: s.vertices_m[s.faces].mean(axis=1) for s in built.scene.surfaces}
    assert set(faces) == {"ground", "forest", "water", "field"}
    for material, number in {"ground": -1, "forest": 0, "water": 1}.items():
        np.testing.assert_array_equal(expected(*faces[material][:, :2].T), number)
    assert len(faces["field"]) == 200
    with pytest.raises(ScenarioError, match=r"terrain.cover_vector.classes.wood: 'forest' is not defined"):
        parse_scenario(tables | {"materials": materials("water", "field")})
    terrain["cover_vector"]["classes"] = {}
    with pytest.raises(ScenarioError, match=r"terrain.cover_vector.classes: empty; map classes"):
        parse_scenario(tables)


def test_classes_that_are_nowhere_are_refused_with_those_that_are(plan):
    table = ClassPolygons(path=plan, attribute="use", materials={"swamp": "water"})
    with pytest.raises(InputFileError, match=r"no polygon of the classes 'swamp' .* are '', '7', 'parish', 'wood'"):
        vector_classes_at(table, RNG.uniform(-99, 99, (100, 2)), None)
    table = ClassPolygons(path=plan, attribute="landuse", materials={"swamp": "water"})
    with pytest.raises(InputFileError, match="no attribute 'landuse'; it has use"):
        vector_classes_at(table, RNG.uniform(-99, 99, (100, 2)), None)
