"""Scenes built from scenarios: what stands where, of which material."""

import numpy as np
import pytest

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import parse_scenario
from sionna_radar.scene.build import build_world

WINDOW = (-500.0, -500.0, 500.0, 500.0)
FLAT = {"kind": "flat", "size_m": [200.0, 100.0], "spacing_m": 5.0}
HILLS = {"kind": "hills", "size_m": [120.0, 120.0], "spacing_m": 1.0, "filter_sigma_m": 15.0}


def build(terrain=None, **tables):
    platform = {"altitude_m": 50.0, "speed_mps": 10.0}
    data = {"terrain": terrain or FLAT, "platform": platform, "radar": {"snr_db": 30.0}}
    return build_world(parse_scenario(data | tables), WINDOW)


def test_flat_ground():
    built = build()
    np.testing.assert_allclose(built.scene.bounds_m, [[-100, -50, 0], [100, 50, 0]])
    np.testing.assert_array_equal(built.ground_m(np.array([[3.0, 4.0], [150.0, 0.0]])), [0.0, np.nan])
    assert [s.material for s in built.scene.surfaces] == ["ground"]
    assert built.scene.georeference is None


def test_mesh_and_ground_agree_on_hills():
    built = build(HILLS)
    place = np.random.default_rng(1).uniform(-59, 59, (2000, 2))
    seen = built.caster.from_above(place, 50.0)
    # The mesh is linear over triangles, the ground bilinear over squares.
    np.testing.assert_allclose(seen, built.ground_m(place), atol=0.02)
    corner = np.round(place)
    np.testing.assert_allclose(built.caster.from_above(corner, 50.0), built.ground_m(corner), atol=1e-4)


@pytest.mark.parametrize("heading_deg", [0.0, 30.0, 90.0])
def test_a_building_stands_where_it_should(heading_deg):
    building = {"position_m": [10.0, -5.0], "size_m": [20.0, 8.0, 6.0], "heading_deg": heading_deg}
    built = build(buildings=[building])
    heading = np.deg2rad(heading_deg)
    along, across = np.array([np.sin(heading), np.cos(heading)]), np.array([np.cos(heading), -np.sin(heading)])
    for a, b, inside in [(9.9, 3.9, True), (-9.9, 3.9, True), (10.1, 0, False), (0, 4.1, False), (0, 0, True)]:
        place = np.array([10.0, -5.0]) + a * along + b * across
        height = built.caster.from_above(place[None], 50.0)[0]
        assert height == pytest.approx(6.0 if inside else 0.0, abs=1e-4)
    box = built.scene.surfaces[-1]
    assert (box.name, box.material) == ("building-0", "building")
    corner = box.vertices_m[box.faces]
    volume = np.sum(np.einsum("fi,fi->f", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))) / 6
    assert volume == pytest.approx(20 * 8 * 6)  # positive: faces turn counter-clockwise seen from outside


def test_a_building_on_a_slope_stands_on_the_lowest_ground_under_it():
    built = build(HILLS, buildings=[{"position_m": [5.0, 5.0], "size_m": [20.0, 20.0, 10.0]}])
    x, y = (k.ravel() for k in np.meshgrid(np.linspace(-5, 15, 81), np.linspace(-5, 15, 81)))
    lowest = built.ground_m(np.column_stack([x, y])).min()
    low, high = built.scene.surfaces[-1].vertices_m[:, 2].min(), built.scene.surfaces[-1].vertices_m[:, 2].max()
    assert low == pytest.approx(lowest, abs=0.02)
    assert high - low == pytest.approx(10.0)


def test_fields_change_the_material_of_their_ground():
    fields = [
        {"centre_m": [50.0, 0.0], "size_m": [100.0, 100.0], "material": "wheat"},
        {"centre_m": [75.0, 0.0], "size_m": [50.0, 100.0], "material": "bare"},  # over the first
    ]
    materials = {
        "wheat": {"model": "constant_gamma", "gamma_db": -25.0},
        "bare": {"model": "lambertian", "nadir_sigma0_db": -20.0},
    }
    built = build(FLAT | {"fields": fields}, materials=materials)
    names = [s.material for s in built.scene.surfaces]
    assert names == ["ground", "wheat", "bare"]
    east = [[s.vertices_m[s.faces][:, :, 0].min(), s.vertices_m[s.faces][:, :, 0].max()] for s in built.scene.surfaces]
    np.testing.assert_allclose(east, [[-100, 0], [0, 50], [50, 100]])
    assert sum(len(s.faces) for s in built.scene.surfaces) == 2 * 40 * 20
    incidence = np.deg2rad([0.0, 60.0])
    wheat, bare = (built.scene.materials[name].sigma0(incidence) for name in ("wheat", "bare"))
    np.testing.assert_allclose(wheat, 10**-2.5 * np.array([1.0, 0.5]))
    np.testing.assert_allclose(bare, 1e-2 * np.array([1.0, 0.25]))


def test_materials_of_the_papers_table():
    for name, gamma_db in [
        ("city", -10.8),
        ("mountain", -21.6),
        ("forest", -25.0),
        ("rolling_hills", -28.8),
        ("desert", -42.2),
    ]:
        scene = build(materials={"ground": {"model": "constant_gamma", "terrain_class": name}}).scene
        assert 10 * np.log10(scene.materials["ground"].sigma0(np.zeros(1))[0]) == pytest.approx(gamma_db, abs=0.05)


def test_targets_stand_on_the_ground():
    built = build(HILLS, targets=[{"position_m": [10.0, 20.0], "height_m": 1.5, "rcs_dbsm": 10.0}])
    (target,) = built.scene.targets
    ground = built.ground_m(np.array([[10.0, 20.0]]))[0]
    assert target.position_m == pytest.approx((10.0, 20.0, ground + 1.5))
    assert target.rcs_m2 == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("tables", "field"),
    [
        (
            {"targets": [{"position_m": [0.0, 0.0], "rcs_dbsm": 0.0}, {"position_m": [500.0, 0.0], "rcs_dbsm": 0.0}]},
            r"targets\.1\.position_m",
        ),
        ({"buildings": [{"position_m": [95.0, 0.0], "size_m": [5.0, 20.0, 5.0]}]}, r"buildings\.0\.position_m"),
    ],
)
def test_what_lies_beyond_the_terrain_is_refused(tables, field):
    with pytest.raises(ScenarioError, match=rf"{field}: .*beyond the terrain"):
        build(**tables)
