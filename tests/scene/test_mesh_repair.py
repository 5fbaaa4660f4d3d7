"""What is broken in a mesh goes or is turned, and how much of it is counted."""

import numpy as np
import pytest
import trimesh

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.scene.mesh_files.part import MeshPart
from sionna_radar.scene.mesh_files.repair import repair

BALL = trimesh.creation.icosphere(subdivisions=2, radius=3.0)


def part(vertices, faces, name=""):
    return MeshPart(name=name, vertices=np.array(vertices, dtype=float), faces=np.array(faces))


def ball(faces=BALL.faces):
    return part(BALL.vertices, faces)


def volume(mesh):
    corner = mesh.vertices_m[mesh.faces]
    return np.einsum("fi,fi->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6


def test_a_sound_mesh_is_left_as_it_is(caplog):
    found = repair([ball()], "x")
    np.testing.assert_array_equal(found.faces, BALL.faces)
    assert not found.two_sided.any()
    assert caplog.text == ""


@pytest.mark.parametrize("split", [False, True], ids=["shared corners", "every face with corners of its own"])
def test_faces_turned_at_random_all_show_their_outside(split, caplog):
    turned = np.random.default_rng(1).random(len(BALL.faces)) < 0.3
    faces = BALL.faces.copy()
    faces[turned] = faces[turned][:, ::-1]
    broken = part(BALL.vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)) if split else ball(faces)
    found = repair([broken], "x")
    assert volume(found) == pytest.approx(BALL.volume)
    assert not found.two_sided.any()
    assert f"{turned.sum()} faces with reversed winding, of 320 faces" in caplog.text


def test_a_solid_inside_out_is_turned_and_its_parts_are_one_solid(caplog):
    """Two halves of two materials close each other."""
    faces = BALL.faces[:, ::-1]
    found = repair([part(BALL.vertices, faces[:100], "a"), part(BALL.vertices, faces[100:], "b")], "x")
    assert volume(found) == pytest.approx(BALL.volume)
    assert not found.two_sided.any()
    np.testing.assert_array_equal(found.owner, np.repeat([0, 1], [100, 220]))
    assert "320 faces with reversed winding" in caplog.text


def test_ground_that_looks_down_is_turned_up_and_a_ceiling_beside_it_stays():
    sheet = np.array([[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0]], dtype=float)
    soffit = sheet / 9 + [20, 0, 5]
    upward = np.array([[0, 1, 2], [0, 2, 3]])
    found = repair([part(sheet, upward), part(soffit, upward[:, ::-1])], "x")
    corner = found.vertices_m[found.faces]
    up = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2] > 0
    np.testing.assert_array_equal(up, [True, True, False, False])
    assert found.two_sided.all()
    found = repair([part(sheet, upward[:, ::-1])], "x")
    corner = found.vertices_m[found.faces]
    assert np.all(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2] > 0)


def test_a_strip_with_one_side_is_kept():
    angle = np.linspace(0, 2 * np.pi, 25)[:-1]
    middle = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    lean = 0.3 * np.column_stack(
        [np.cos(angle / 2) * middle[:, 0], np.cos(angle / 2) * middle[:, 1], np.sin(angle / 2)]
    )
    vertices = np.concatenate([middle + lean, middle - lean])
    i = np.arange(23)
    quads = np.concatenate([np.column_stack([i, i + 1, i + 25, i + 24]), [[23, 24, 0, 47]]])
    found = repair([part(vertices, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]))], "x")
    assert len(found.faces) == 48
    assert found.two_sided.all()


def test_what_is_no_surface_goes_and_is_counted(caplog):
    vertices = np.concatenate([BALL.vertices, [[np.nan, 0, 0], [np.inf, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, 3]]])
    first = len(BALL.vertices)
    bad = [[0, 1, first], [0, 1, first + 1], [first + 2, first + 3, first + 4], [5, 5, 6]]
    twice = [BALL.faces[7], BALL.faces[8][::-1]]
    found = repair([part(vertices, np.concatenate([BALL.faces, bad, twice]))], "objects.0.path = a.ply")
    assert len(found.faces) == 320
    assert volume(found) == pytest.approx(BALL.volume)
    assert (
        "objects.0.path = a.ply: repaired 2 faces with a vertex that is no place, 2 faces without an area, "
        "2 faces that are there twice, of 326 faces"
    ) in caplog.text


def test_a_mesh_of_nothing_else_is_refused_with_the_counts():
    with pytest.raises(InputFileError, match=r"none of its 2 faces is a surface \(1 faces with a vertex that is no"):
        repair([part([[0, 0, 0], [1, 0, 0], [2, 0, 0], [np.nan, 0, 0]], [[0, 1, 2], [0, 1, 3]])], "x")


def test_a_shell_with_a_gap_is_turned_by_what_it_encloses(caplog):
    """As a teapot without a bottom, and a house without a floor: whichever way it faces, its roof looks up."""
    house = trimesh.creation.box(bounds=[(0, 0, 0), (8, 6, 5)])
    upper = house.faces[house.vertices[house.faces][:, :, 2].max(axis=1) > 0]
    assert len(upper) == 10
    found = repair([part(house.vertices, upper[:, ::-1])], "x")
    corner = found.vertices_m[found.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert np.all(np.einsum("fi,fi->f", normal, corner.mean(axis=1) - [4, 3, 2]) > 0)
    assert found.two_sided.all()
    assert "10 faces with reversed winding" in caplog.text


def test_corners_that_differ_by_the_rounding_of_a_text_file_are_one():
    vertices = BALL.vertices[BALL.faces].reshape(-1, 3) + 1e-7 * np.random.default_rng(1).uniform(-1, 1, (960, 3))
    found = repair([part(vertices, np.arange(960).reshape(-1, 3))], "x")
    assert not found.two_sided.any()


def test_two_solids_that_share_a_wall_lose_one_copy_of_it_and_keep_their_outsides():
    corners = [[0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, 4], [1, 1, -4]]
    upper, lower = [[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 2, 1]], [[1, 0, 4], [2, 1, 4], [0, 2, 4], [0, 1, 2]]
    found = repair([part(corners, upper), part(corners, lower)], "x")
    assert len(found.faces) == 7
    outer = np.any(found.faces >= 3, axis=1)
    corner = found.vertices_m[found.faces][outer]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert np.all(np.einsum("fi,fi->f", normal, corner.mean(axis=1) - [1, 1, 0]) > 0)
