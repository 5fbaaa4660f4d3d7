"""Wires, poles and fences of a scenario: where they hang and stand, files of power lines, and what is refused."""

import json
import logging
from pathlib import Path

import numpy as np
import pytest

from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.scenario import Scenario, parse_scenario
from sionna_radar.scene.build import build_world
from sionna_radar.scene.thin import build
from sionna_radar.scene.wires import ThinObstacle
from vector_files import write_geojson

WINDOW_M = (-100.0, -100.0, 100.0, 100.0)
SLOPE = 0.1


def scenario(**tables: object) -> Scenario:
    """Flat ground with some thin obstacles."""
    return parse_scenario(
        {
            "terrain": {"kind": "flat", "size_m": [200.0, 200.0]},
            "platform": {"altitude_m": 40.0, "speed_mps": 10.0, "length_m": 20.0},
            "radar": {"snr_db": 30.0},
            **tables,
        }
    )


def thin(**tables: object) -> tuple[ThinObstacle, ...]:
    """The thin obstacles of a scenario."""
    return build_world(scenario(**tables), WINDOW_M).scene.thin


POLE = {"position_m": [0, 0], "length_m": 9, "diameter_mm": 50}
WIRE = {"points_m": [[-50.0, 0.0, 15.0], [50.0, 0.0, 15.0]], "diameter_mm": 10.0}


def test_wires_hang_side_by_side_over_the_ground() -> None:
    """Three of them, 4 m apart on the level, or above each other, each with its sag."""
    (level,) = thin(wires=[{**WIRE, "sag_m": 2.0, "count": 3, "spacing_m": 4.0}])
    assert (level.name, level.kind, len(level.wires)) == ("wires.0", "wires", 3)
    np.testing.assert_allclose([wire.vertex_m[0, 1] for wire in level.wires], [4, 0, -4])
    for wire in level.wires:
        assert wire.points(1.0)[:, 2].min() == pytest.approx(13.0, abs=0.01)
        assert wire.radius_m == pytest.approx(5e-3)
        assert wire.reflectivity == 1.0
    (upright,) = thin(wires=[{**WIRE, "count": 2, "spacing_m": 1.5, "arrangement": "upright"}])
    np.testing.assert_allclose([wire.vertex_m[0, 2] for wire in upright.wires], [15, 16.5])


def test_a_medium_reflects_as_fresnel_says() -> None:
    """Wood at 77 GHz: eps 1.99 of ITU-R P.2040, |1 - sqrt(eps)|^2 / |1 + sqrt(eps)|^2 from in front."""
    (pole,) = thin(poles=[{"position_m": [0, 0], "length_m": 8.0, "diameter_mm": 250.0, "medium": {"kind": "wood"}}])
    root = np.sqrt(1.99)
    assert pole.wires[0].reflectivity == pytest.approx(((root - 1) / (root + 1)) ** 2, rel=0.05)


def test_a_wire_may_be_upright_and_end_on_the_ground() -> None:
    """Parallels of an upright leg lie beside the next leg, or east and west; there is no support of height 0."""
    upright = [[0, 0, 2], [0, 0, 9]]
    for points, aside in (([*upright, [5, 0, 9]], [0, -1, 0]), (upright, [1, 0, 0])):
        wires = thin(wires=[{"points_m": points, "diameter_mm": 5, "count": 2, "spacing_m": 2}])[0].wires
        for wire, side in zip(wires, (-1, 1), strict=True):
            np.testing.assert_allclose(wire.vertex_m, np.array(points) + side * np.array(aside))
    stayed = thin(wires=[{"points_m": [[0, 0, 0], [5, 0, 9]], "diameter_mm": 5, "pylons": "lattice"}])
    assert [one.name for one in stayed] == ["wires.0", "wires.0-pylon-1"]


def test_poles_lean_where_they_are_told_to() -> None:
    """A branch 3 m up that points east, level; a lattice mast of many members."""
    branch, mast = thin(
        poles=[
            {
                "position_m": [1, 2], "base_m": 3.0, "length_m": 2.0, "diameter_mm": 20.0, "shape": "branch",
                "tilt_deg": 90.0, "heading_deg": 90.0,
            },
            {"position_m": [10, 0], "length_m": 30.0, "diameter_mm": 80.0, "shape": "lattice", "width_m": [4, 1]},
        ]
    )  # fmt: skip
    np.testing.assert_allclose(branch.wires[0].vertex_m, [[1, 2, 3], [3, 2, 3]], atol=1e-9)
    assert len(branch.wires) == 7
    ends = np.concatenate([wire.vertex_m for wire in mast.wires])
    np.testing.assert_allclose(ends.min(axis=0), [8, -2, 0], atol=1e-9)
    np.testing.assert_allclose(ends.max(axis=0), [12, 2, 30], atol=1e-9)


def test_a_fence_has_posts_and_wires() -> None:
    """Posts no farther apart than they may be, wires from the ground up to their tops."""
    (fence,) = thin(fences=[{"points_m": [[0, 0], [10, 0], [10, 7]], "height_m": 1.2, "wires": 2}])
    posts = [wire for wire in fence.wires if wire.radius_m == pytest.approx(0.04)]
    strung = [wire for wire in fence.wires if wire.radius_m != pytest.approx(0.04)]
    assert len(posts) == 4 + 3 + 1
    np.testing.assert_allclose([wire.vertex_m[0, 2] for wire in strung], [0.6, 1.2])


def power_lines(path: Path, **members: object) -> Path:
    """Two lines with heights in OpenStreetMap's notation, one without, and a point."""
    lines = [
        ({"type": "LineString", "coordinates": [[-50, 0], [0, 5], [50, 0]]}, {"height": "20 m"}),
        ({"type": "MultiLineString", "coordinates": [[[-50, 30], [50, 30]]]}, {"height": "40 ft"}),
        ({"type": "LineString", "coordinates": [[-50, 60], [50, 60]]}, {"height": None}),
        ({"type": "Point", "coordinates": [0, 0]}, {"height": "3"}),
    ]
    return write_geojson(path, lines, **members)


def test_power_lines_of_a_file_with_their_pylons(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A support at each vertex; lines without a height are left out and said."""
    table = {"path": str(power_lines(tmp_path / "lines.geojson")), "height": "height", "diameter_mm": 22.0}
    with caplog.at_level(logging.WARNING):
        obstacles = thin(wires=[{**table, "pylons": "pole"}])
    wires = [one for one in obstacles if one.kind == "wires"]
    pylons = [one for one in obstacles if one.kind == "poles"]
    assert [one.name for one in wires] == ["wires.0-0", "wires.0-1"]
    np.testing.assert_allclose([one.wires[0].vertex_m[0, 2] for one in wires], [20.0, 40 * 0.3048])
    assert [one.name for one in pylons] == [f"wires.0-0-pylon-{n}" for n in range(3)] + [
        f"wires.0-1-pylon-{n}" for n in range(2)
    ]
    np.testing.assert_allclose(pylons[1].wires[0].vertex_m, [[0, 5, 0], [0, 5, 20]])
    assert "1 lines without a height, 0 beyond the terrain, and 1 features that are no lines" in caplog.text
    assert len([one for one in thin(wires=[{**table, "height_m": 8.0}]) if one.kind == "wires"]) == 3
    lattice = thin(wires=[{**table, "pylons": "lattice"}])
    assert len(lattice[1].wires) > 20


def test_lines_that_meet_share_a_pylon(tmp_path: Path) -> None:
    """A power line that is mapped in two parts, a branch of another height at its middle, and a ring of wire."""
    parts = [([[-50, 0], [0, 5]], "20 m"), ([[0, 5], [50, 0]], "20 m"), ([[0, 5], [0, 40]], "24 m")]
    lines = [({"type": "LineString", "coordinates": line}, {"height": height}) for line, height in parts]
    table = {"path": str(write_geojson(tmp_path / "lines.geojson", lines)), "height": "height", "diameter_mm": 22.0}
    pylons = [one for one in thin(wires=[{**table, "pylons": "pole"}]) if one.kind == "poles"]
    tops = sorted(tuple(one.wires[0].vertex_m[1]) for one in pylons)
    np.testing.assert_allclose(tops, [(-50, 0, 20), (0, 5, 24), (0, 40, 24), (50, 0, 20)], atol=1e-9)
    above = {"count": 3, "spacing_m": 2.0, "arrangement": "upright"}
    higher = [one for one in thin(wires=[{**table, **above, "pylons": "pole"}]) if one.kind == "poles"]
    np.testing.assert_allclose(sorted(one.wires[0].vertex_m[1, 2] for one in higher), [24, 24, 28, 28])
    ring = [[0, 0, 9], [9, 0, 9], [9, 9, 9], [0, 0, 9]]
    around = thin(wires=[{"points_m": ring, "diameter_mm": 5, "pylons": "lattice"}])
    assert [one.name for one in around] == ["wires.0", *(f"wires.0-pylon-{n}" for n in range(3))]


@pytest.mark.parametrize(
    ("tables", "field", "words"),
    [
        ({"wires": [{"points_m": [[0, 0, 5], [9, 0, 5]], "diameter_mm": 0}]}, "wires.0.diameter_mm", "greater"),
        ({"wires": [{**WIRE, "sag_m": 16.0}]}, "wires.0.points_m", "1.0 m under the ground at"),
        ({"wires": [{"points_m": [[0, 0], [9, 0]], "diameter_mm": 5}]}, "wires.0.points_m.0.2", "missing"),
        ({"wires": [{"points_m": [[0, 0, 5]], "diameter_mm": 5}]}, "wires.0.points_m", "has one point"),
        ({"wires": [{"points_m": [[0, 0, 5], [0, 0, 5]], "diameter_mm": 5}]}, "wires.0.points_m", "equal"),
        ({"wires": [{"points_m": [[0, 0, 5], [500, 0, 5]], "diameter_mm": 5}]}, "wires.0.points_m", "beyond the"),
        ({"wires": [{**WIRE, "count": 3}]}, "wires.0.spacing_m", "give both or none"),
        ({"wires": [{**WIRE, "strands": 12}]}, "wires.0.lay_mm", "give both or none"),
        ({"wires": [{**WIRE, "strands": 12, "lay_mm": 0.2}]}, "wires.0.lay_mm", "one turn"),
        ({"wires": [{**WIRE, "strands": 3, "lay_mm": 9000}]}, "wires.0.lay_mm", "lobes on either side, more than 100"),
        ({"wires": [{**WIRE, "strands": 3, "lay_mm": 900, "diameter_mm": 500}]}, "wires.0.diameter_mm", "at most 100"),
        ({"wires": [{"points_m": [[0, 0, 5], [0, 1e12, 5]], "diameter_mm": 5, "heights": "datum"}]}, "wires", "in all"),
        (
            {"wires": [{**WIRE, "points_m": [[0, 0, 5], [0, 900, 5]], "heights": "datum", "pylons": "pole"}]},
            "wires.0.points_m", "beyond the terrain",
        ),
        ({"poles": [{**POLE, "length_m": 1e15}]}, "poles.0.length_m", "must be at most 1000"),
        ({"poles": [{**POLE, "base_m": 1001.0}]}, "poles.0.base_m", "must be at most 1000"),
        ({"fences": [{"points_m": [[0, 0], [9, 0]], "height_m": 2000}]}, "fences.0.height_m", "at most 1000"),
        ({"wires": [{"points_m": [[0, 0, 1e5], [9, 0, 5]], "diameter_mm": 5}]}, "wires.0.points_m", "100,000 m above"),
        ({"fences": [{"points_m": [[0, 0], [9, 0]], "height_m": 1, "post_spacing_m": 1e-6}]}, "fences.0", "post or"),
        ({"wires": [{**WIRE, "path": "lines.geojson"}]}, "wires.0.points_m", "not both"),
        ({"wires": [{"path": "lines.geojson", "diameter_mm": 5}]}, "wires.0.height_m", "missing"),
        ({"wires": [{**WIRE, "pylon_width_m": 1.0}]}, "wires.0.pylon_width_m", "no effect"),
        ({"poles": [{**POLE, "tilt_deg": 120}]}, "poles.0.tilt_deg", "under"),
        ({"poles": [{**POLE, "position_m": [900, 0]}]}, "poles.0.position_m", "beyond"),
        ({"poles": [{**POLE, "width_m": [1, 1]}]}, "poles.0.width_m", "lattice"),
        ({"fences": [{"points_m": [[0, 0]], "height_m": 1}]}, "fences.0.points_m", "2"),
        (
            {"poles": [{**POLE, "medium": {"kind": "marble"}}]},
            "poles.0.medium", "marble",
        ),
    ],
)  # fmt: skip
def test_what_cannot_stand_is_refused(tables: dict[str, object], field: str, words: str) -> None:
    """One error, with the field and the reason."""
    with pytest.raises(ScenarioError) as caught:
        thin(**tables)
    assert any(problem.field.startswith(field) and words in problem.message for problem in caught.value.problems)


def test_poles_of_more_length_than_fits_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """As wires are, of which few are enough; poles are at most a kilometre long."""
    monkeypatch.setattr(build, "MAX_LENGTH_M", 1e5)
    thin(poles=[{**POLE, "length_m": 1000}] * 100)
    with pytest.raises(ScenarioError, match=r"poles: have 101 km in all, more than 100;"):
        thin(poles=[{**POLE, "length_m": 1000}] * 101)


@pytest.mark.parametrize("content", ["", "{", '{"type": "FeatureCollection"}', json.dumps([1, 2])])
def test_damaged_files_of_lines_are_refused(tmp_path: Path, content: str) -> None:
    """Nothing but an error of the input file."""
    path = tmp_path / "lines.geojson"
    path.write_text(content)
    with pytest.raises(InputFileError, match=r"wires\.0\.path"):
        thin(wires=[{"path": str(path), "height_m": 9.0, "diameter_mm": 5.0}])


def test_lines_that_leave_the_terrain_are_cut_and_files_without_lines_warned_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Of a line of six supports the two runs on the terrain; of an empty file, and one far away, nothing, said."""
    corners = [[-50, 0], [0, 0], [900, 0], [900, 20], [50, 20], [0, 20]]
    for name, line in (("cut", corners), ("far", [[9000, 0], [9100, 0]]), ("empty", [])):
        lines = [({"type": "LineString", "coordinates": line}, {})] if line else []
        path = write_geojson(tmp_path / f"{name}.json", lines)
        with caplog.at_level(logging.WARNING):
            obstacles = thin(wires=[{"path": str(path), "height_m": 9.0, "diameter_mm": 5.0}])
        if line != corners:
            assert obstacles == ()
            assert f"{name}.json has no line near the survey" in caplog.text
            continue
        (first,), (second,) = (one.wires for one in obstacles)
        np.testing.assert_allclose(first.vertex_m, [[-50, 0, 9], [0, 0, 9]])
        np.testing.assert_allclose(second.vertex_m, [[50, 20, 9], [0, 20, 9]])
        assert "cut 1 lines where they leave it" in caplog.text


def test_heights_of_the_vertices_of_a_file_are_not_read_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A line whose vertices have a z hangs as high as its key says, and the other line is not counted."""
    lines = [[[-50, 0, 31], [50, 0, 32]], [[-50, 20], [50, 20]]]
    path = write_geojson(tmp_path / "z.json", [({"type": "LineString", "coordinates": line}, {}) for line in lines])
    with caplog.at_level(logging.WARNING):
        obstacles = thin(wires=[{"path": str(path), "height_m": 9.0, "diameter_mm": 5.0}])
    assert {one.wires[0].vertex_m[0, 2] for one in obstacles} == {9.0}
    assert "the z coordinates of 1 lines are not read" in caplog.text


def test_a_line_without_heights_anywhere_is_refused(tmp_path: Path) -> None:
    """A file none of whose lines can hang."""
    path = write_geojson(
        tmp_path / "lines.json", [({"type": "LineString", "coordinates": [[0, 0], [9, 0]]}, {"height": "low"})]
    )
    with pytest.raises(InputFileError, match="none of its 1 lines has a height"):
        thin(wires=[{"path": str(path), "height": "height", "diameter_mm": 5.0}])


def test_many_vertices_in_a_file_are_read_and_more_length_than_fits_is_refused(tmp_path: Path) -> None:
    """A wiggling line of 50,000 vertices within the window; wires of 10,000 km in all are too much."""
    x = np.linspace(-50, 50, 50_000)
    line = np.column_stack([x, 5 * np.sin(x)]).round(4).tolist()
    path = write_geojson(tmp_path / "lines.json", [({"type": "LineString", "coordinates": line}, {})])
    (obstacle,) = thin(wires=[{"path": str(path), "height_m": 9.0, "diameter_mm": 5.0}])
    assert len(obstacle.wires[0].vertex_m) > 47_500
    zigzag = [[(-1) ** n * 99.0, 0.0, 9.0 + n * 1e-4] for n in range(6000)]
    with pytest.raises(ScenarioError, match=r"wires: have .* km in all, more than 10,000"):
        thin(wires=[{"points_m": zigzag, "diameter_mm": 5.0, "count": 10, "spacing_m": 0.01}])


def test_a_wire_through_a_building_is_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    """It is kept, and said with its place."""
    with caplog.at_level(logging.WARNING):
        (obstacle,) = thin(wires=[WIRE], buildings=[{"position_m": [10, 0], "size_m": [8, 8, 20]}])
    assert len(obstacle.wires) == 1
    assert "wires.0 leads through a surface near (5.0, 0.0, 15.0) m" in caplog.text
