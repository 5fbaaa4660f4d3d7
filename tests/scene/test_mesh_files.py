"""Mesh files of all formats, written by another library or by hand, give the triangles that are in them."""

import json
import struct

import numpy as np
import pytest
import trimesh

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.scene.mesh_files.reader import read_mesh, up_axis

BOX = trimesh.creation.box((2.0, 3.0, 4.0), transform=trimesh.transformations.translation_matrix([5.0, 6.0, 7.0]))
WRITERS = {
    "box.ply": {"encoding": "binary"},
    "text.ply": {"encoding": "ascii"},
    "box.stl": {"file_type": "stl"},
    "text.stl": {"file_type": "stl_ascii"},
    "box.obj": {},
    "box.glb": {},
}


def read(path):
    return read_mesh(path, "terrain.path")


def volume(part):
    corner = part.vertices[part.faces]
    return np.einsum("fi,fi->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6


def area(part):
    corner = part.vertices[part.faces]
    return np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum() / 2


@pytest.mark.parametrize("name", WRITERS)
def test_a_box_of_another_library_is_that_box(name, tmp_path):
    BOX.export(tmp_path / name, **WRITERS[name])
    (part,) = read(tmp_path / name)
    assert len(part.faces) == 12
    assert volume(part) == pytest.approx(24.0, rel=1e-6)
    used = part.vertices[np.unique(part.faces)]
    np.testing.assert_allclose([used.min(axis=0), used.max(axis=0)], BOX.bounds, atol=1e-6)


def test_a_gltf_file_finds_its_buffer_beside_it(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(BOX, transform=trimesh.transformations.rotation_matrix(0.5, [1, 2, 3], [1, 0, 0]))
    for name, data in trimesh.exchange.gltf.export_gltf(scene).items():
        (tmp_path / name).write_bytes(data)
    (part,) = read(tmp_path / "model.gltf")
    expected = scene.to_mesh()
    np.testing.assert_allclose(np.sort(part.vertices[part.faces].mean(axis=1)), np.sort(expected.triangles_center))
    assert up_axis(tmp_path / "model.gltf") == "y"


@pytest.mark.parametrize("order", ["little", "big"])
def test_a_ply_of_triangles_and_quadrangles_is_read_row_by_row(order, tmp_path):
    sign = "<" if order == "little" else ">"
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 2, 0)]
    head = (
        f"ply\nformat binary_{order}_endian 1.0\ncomment made by hand\nelement vertex 5\nproperty double x\n"
        "property double y\nproperty double z\nproperty uchar red\nelement face 2\nproperty uchar flags\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    rows = b"".join(struct.pack(f"{sign}dddB", *corner, 9) for corner in corners)
    rows += struct.pack(f"{sign}BB4i", 1, 4, 0, 1, 2, 3) + struct.pack(f"{sign}BB3i", 1, 3, 3, 2, 4)
    (tmp_path / "mixed.ply").write_bytes(head.encode() + rows)
    (part,) = read(tmp_path / "mixed.ply")
    assert len(part.faces) == 3
    assert area(part) == pytest.approx(1.5)


def test_an_obj_counts_back_splits_concave_polygons_and_names_its_materials(tmp_path):
    """An L of six corners, whose fan would leave it; then a quadrangle with an inward corner, by negative indices."""
    text = """mtllib anything.mtl
v 0 0 0
v 2 0 0
v\t2\t1\t0
v 1 1 0
v 1 2 0
v 0 2 0
usemtl asphalt
f 4/1/1 5/2/1 6//1 1 2 3
v 0 0 5
v 1 -1 5
v 0 2 5
v -1 -1 5
usemtl roof tiles
f -4 -3 -2 \\
 -1
v 9 9 9
"""
    (tmp_path / "two.obj").write_text(text)
    asphalt, roof = read(tmp_path / "two.obj")
    assert (asphalt.name, roof.name) == ("asphalt", "roof tiles")
    assert (len(asphalt.faces), area(asphalt)) == (4, pytest.approx(3.0))
    assert (len(roof.faces), area(roof)) == (2, pytest.approx(2.0))
    normal = np.cross(*np.diff(asphalt.vertices[asphalt.faces], axis=1).transpose(1, 0, 2))
    assert np.all(normal[:, 2] > 0)  # all turn as the polygon does


def write_gltf(path, nodes, primitive, **more):
    """Write a strip of a square and a triangle by hand: two triangles, of five corners with a stride."""
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 2, 0]], dtype="<f4")
    rows = np.zeros(5, dtype=[("place", "<f4", 3), ("other", "<f4")])
    rows["place"] = corner
    index = np.array([0, 1, 2, 3], dtype="<u2")
    document = {
        "asset": {"version": "2.0"},
        "nodes": nodes,
        "materials": [{"name": "tin"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, **primitive}, {"mode": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 5, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 4, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 80, "byteStride": 16},
            {"buffer": 0, "byteOffset": 80, "byteLength": 8},
        ],
        "buffers": [{"byteLength": 88}],
        "images": [{"uri": "../../etc/passwd"}],
        **more,
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary = rows.tobytes() + index.tobytes()
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


def test_nodes_of_a_glb_move_its_triangles_and_a_mirror_keeps_the_outside_out(tmp_path):
    nodes = [
        {"children": [1], "translation": [10, 0, 0], "scale": [2, 2, 2]},
        {"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 3, 1]},
    ]
    (part,) = read(write_gltf(tmp_path / "a.glb", nodes, {"mode": 5, "material": 0}))
    assert part.name == "tin"
    used = part.vertices[np.unique(part.faces)]
    np.testing.assert_allclose([used.min(axis=0), used.max(axis=0)], [[8, 0, 6], [10, 2, 6]])
    corner = part.vertices[part.faces]
    assert np.all(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2] == pytest.approx(4.0))


@pytest.mark.parametrize(
    ("nodes", "more", "message"),
    [
        ([{"mesh": 0, "children": [0]}], {"scenes": [{"nodes": [0]}]}, "in a circle"),
        ([{"mesh": 7}], {}, r"meshes\[7\], which it does not have"),
        ([{"mesh": 0}], {"extensionsUsed": ["KHR_draco_mesh_compression"]}, "without compression"),
        ([{"mesh": 0}], {"bufferViews": [{"buffer": 0, "byteLength": 75, "byteStride": 16}, {}]}, "of 5 rows"),
        ([{"mesh": 0}], {"asset": {"version": "1.0"}}, "convert it to 2.0"),
    ],
)
def test_a_glb_that_is_none_says_where(nodes, more, message, tmp_path):
    with pytest.raises(InputFileError, match=message):
        read(write_gltf(tmp_path / "a.glb", nodes, {}, **more))


@pytest.mark.parametrize(
    ("primitive", "position", "message"),
    [
        ({"mode": 6}, {}, r"a fan of triangles in meshes\[0\]"),
        ({}, {"sparse": {"count": 1}}, r"accessors\[0\] that is sparse"),
        ({}, {"normalized": True, "componentType": 5123}, r"accessors\[0\] that is sparse, normalized"),
    ],
)
def test_a_glb_of_what_the_library_passes_over_is_refused(primitive, position, message, tmp_path):
    path = write_gltf(tmp_path / "a.glb", [{"mesh": 0}], primitive)
    data = path.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + size])
    document["accessors"][0] |= position
    write_gltf(path, [{"mesh": 0}], primitive, accessors=document["accessors"])
    with pytest.raises(InputFileError, match=message):
        read(path)


def test_no_primitive_of_many_is_lost(tmp_path):
    """Of so many the library loses some, whose random names are the same."""
    one = {"attributes": {"POSITION": 0}, "indices": 1, "mode": 5}
    path = write_gltf(tmp_path / "a.glb", [{"mesh": 0}], {}, meshes=[{"primitives": [one] * 4000}])
    assert len(read(path)) == 4000


def test_cameras_pictures_and_more_of_a_glb_change_no_place(tmp_path):
    """The library would open the picture, and lose the place of a node with a camera."""
    nodes = [{"camera": 0, "translation": [10, 0, 0], "children": [1]}, {"mesh": 0, "extensions": {"X": {}}}]
    more = {
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1, "znear": 1}}],
        "materials": [{"name": "tin", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
    }
    (part,) = read(write_gltf(tmp_path / "a.glb", nodes, {"mode": 5, "material": 0}, **more))
    assert (part.name, part.vertices[:, 0].min()) == ("tin", pytest.approx(10.0))


def test_text_keeps_the_digits_that_float32_has_not(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "utm.ply").write_text(
        f"{head}500000.123 5000000.123 1\n500001 5000000 1\n500001 5000001 1\n3 0 1 2 9 9\n"
    )
    (part,) = read(tmp_path / "utm.ply")
    assert part.vertices[0].tolist() == [500000.123, 5000000.123, 1.0]


def test_a_solid_of_text_that_does_not_end_is_missed(tmp_path):
    text = BOX.export(file_type="stl_ascii")
    (tmp_path / "two.stl").write_text(f"{text}\n{text[: len(text) // 2]}")
    with pytest.raises(InputFileError, match="of which 12 are whole"):
        read(tmp_path / "two.stl")
    (tmp_path / "two.stl").write_bytes(f"{text}\n{text}".replace("solid", "SOLID größe").encode("latin-1"))
    assert sum(len(part.faces) for part in read(tmp_path / "two.stl")) == 24


SCENE = """<scene version="2.1.0">
  <default name="spp" value="16"/>
  <bsdf type="twosided" id="mat-itu_brick"><bsdf type="diffuse"/></bsdf>
  <shape type="ply" id="house">
    <string name="filename" value="meshes/box.ply"/>
    <ref id="mat-itu_brick" name="bsdf"/>
    <transform name="to_world">
      <scale x="2" y="1" z="1"/>
      <rotate z="1" angle="90"/>
      <translate value="100, 0, 0"/>
      <matrix value="1 0 0 0  0 1 0 0  0 0 1 50  0 0 0 1"/>
    </transform>
  </shape>
  <shape type="rectangle" id="lawn">
    <boolean name="flip_normals" value="true"/>
    <transform name="to_world"><scale value="10"/></transform>
  </shape>
  <shape type="cube" id="block"><bsdf type="diffuse" id="mat-tin"/></shape>
  <emitter type="constant"/>
</scene>
"""


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "meshes").mkdir()
    BOX.export(tmp_path / "meshes" / "box.ply")
    (tmp_path / "scene.xml").write_text(SCENE)
    return tmp_path / "scene.xml"


def test_a_scene_of_mitsuba_is_what_mitsuba_makes_of_it(scene):
    from sionna_radar.raytracer.backend import load_mitsuba

    mi = load_mitsuba()
    house, lawn, block = read(scene)
    assert [part.name for part in (house, lawn, block)] == ["itu_brick", "lawn", "tin"]
    place = mi.ScalarTransform4f().translate([0, 0, 50]).translate([100, 0, 0]).rotate([0, 0, 1], 90).scale([2, 1, 1])
    theirs = np.array([np.array(place @ mi.ScalarPoint3f(*map(float, v))) for v in BOX.vertices])
    np.testing.assert_allclose(np.sort(house.vertices, axis=0), np.sort(theirs, axis=0), atol=1e-4)
    assert (volume(house), volume(block)) == (pytest.approx(48.0, rel=1e-5), pytest.approx(8.0))
    assert area(lawn) == pytest.approx(400.0)
    assert np.cross(*np.diff(lawn.vertices[lawn.faces[0]], axis=0))[2] < 0  # turned over, as asked


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('type="cube"', 'type="sphere"', "line 18: a shape of type 'sphere'"),
        ('<emitter type="constant"/>', '<include filename="other.xml"/>', "line 19: <include>"),
        ('<scale value="10"/>', '<lookat origin="0"/>', "line 16: a transform by <lookat>"),
        ('x="2"', 'x="2 3"', "line 8: '2 3' is not 1 number"),
        ("meshes/box.ply", "meshes/none.ply", "line 4 of .* names .* does not exist"),
        ('angle="90"', 'angle="1e999"', "line 9"),
        ("</scene>", "", "is not XML"),
    ],
)
def test_what_a_scene_holds_that_is_not_read_is_refused_with_its_line(old, new, message, scene):
    scene.write_text(SCENE.replace(old, new))
    with pytest.raises(InputFileError, match=message):
        read(scene)


def test_a_comment_broken_into_lines_does_not_end_a_ply(tmp_path):
    """Some versions of Blender wrote one so."""
    BOX.export(tmp_path / "box.ply", encoding="ascii")
    text = (tmp_path / "box.ply").read_text()
    (tmp_path / "box.ply").write_text(
        text.replace("element vertex", "comment made by\nBlender, source file:\nelement vertex")
    )
    (part,) = read(tmp_path / "box.ply")
    assert volume(part) == pytest.approx(24.0, rel=1e-6)


def test_the_ending_says_what_a_mesh_is(tmp_path):
    (tmp_path / "mesh.dae").write_text("<COLLADA/>")
    with pytest.raises(InputFileError, match=r"'.dae'; give a mesh: .ply, .obj"):
        read(tmp_path / "mesh.dae")
    (tmp_path / "points.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "end_header\n1 2 3\n"
    )
    with pytest.raises(InputFileError, match="a point cloud is not a surface"):
        read(tmp_path / "points.ply")
