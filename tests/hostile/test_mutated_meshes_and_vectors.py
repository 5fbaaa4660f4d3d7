"""Files of all kinds of meshes and polygons, cut, flipped and lied about: one clear error, or a right result."""

import contextlib
import json
import os
import sqlite3
import struct
import time
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh

from mutants import mutated
from sionna_radar.foundation.errors import RadarError
from sionna_radar.scene.mesh_files.repair import repair
from sionna_radar.scene.objects import MeshSource, upright
from sionna_radar.scene.vector_file import VectorQuery, read_polygons
from vector_files import rectangle, write_by_gdal, write_geojson

KIND_OF = {".geojson": "vector", ".gpkg": "vector", ".shp": "vector"}
MUTANTS = 10
LONGEST_S = 5.0
WINDOW = (-1000.0, -1000.0, 1000.0, 1000.0)


def as_mesh(path):
    mesh = repair(upright(MeshSource(path=path), "objects.0"), "objects.0.path")
    assert np.isfinite(mesh.vertices_m[mesh.faces]).all()
    return len(mesh.faces)


def as_vector(path):
    query = VectorQuery(path=path, layer=None, key="footprints.0", attributes=["height"], frame=None, window_m=WINDOW)
    found = read_polygons(query)
    assert np.isfinite(shapely.get_coordinates(found.shape)).all()
    assert shapely.is_valid(found.shape).all()
    return len(found.shape)


def read(path):
    return as_vector(path) if KIND_OF.get(path.suffix) else as_mesh(path)


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Files that read well, by name; each in a folder of its own, with what it needs beside it."""
    folder = tmp_path_factory.mktemp("sound")
    ball = trimesh.creation.icosphere(subdivisions=1, radius=2.0)
    paths = {}

    def place(name):
        paths[name] = folder / name.replace(".", "-") / name
        paths[name].parent.mkdir()
        return paths[name]

    ball.export(place("binary.ply"))
    ball.export(place("text.ply"), encoding="ascii")
    ball.export(place("binary.stl"))
    ball.export(place("text.stl"), file_type="stl_ascii")
    ball.export(place("one.glb"))
    text = trimesh.exchange.obj.export_obj(ball).replace("\nf", "\nusemtl a\nf")
    place("two.obj").write_text(f"mtllib two.mtl\n{text}")
    (paths["two.obj"].parent / "two.mtl").write_text("newmtl a\nmap_Kd ../../picture.png\n")
    for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(ball)).items():
        path = paths.get("model.gltf") or place("model.gltf")
        (path.parent / name).write_bytes(data)
    scene = place("scene.xml")
    ball.export(scene.parent / "ball.ply")
    scene.write_text(
        '<scene version="3.0.0">\n<bsdf type="diffuse" id="mat-a"/>\n<shape type="ply" id="b">\n'
        '<string name="filename" value="ball.ply"/>\n'
        '<ref id="mat-a" name="bsdf"/>\n<transform name="to_world"><rotate x="1" angle="30"/>'
        '<translate value="1, 2, 3"/></transform>\n</shape>\n<shape type="cube" id="c"/>\n</scene>\n'
    )
    rings = [[rectangle(20 * i, 0, 20 * i + 10, 10)] for i in range(6)]
    write_geojson(place("a.geojson"), [(ring, {"height": i}) for i, ring in enumerate(rings)])
    shapes = [(shapely.Polygon(*ring), {"height": float(i)}) for i, ring in enumerate(rings)]
    for name in ("a.gpkg", "a.shp"):
        with pytest.warns(UserWarning, match="'crs' was not provided"):
            write_by_gdal(place(name), shapes, None)
    return paths


def test_the_sound_ones_are_sound(sound):
    counts = {name: read(path) for name, path in sound.items()}
    assert {name: counts[name] for name in counts if KIND_OF.get(sound[name].suffix)} == dict.fromkeys(
        ("a.geojson", "a.gpkg", "a.shp"), 6
    )
    assert counts.pop("scene.xml") == 92
    assert {count for name, count in counts.items() if "." in name and not name.startswith("a.")} == {80}


@pytest.mark.parametrize("number", range(12))
def test_a_mutated_file_ends_in_one_error_or_a_right_result(sound, number, tmp_path):
    name = sorted(sound)[number % len(sound)]
    source = sound[name]
    # In a folder of its own, with sound files beside it; of a Shapefile each of the files in turn.
    for other in source.parent.iterdir():
        (tmp_path / other.name).write_bytes(other.read_bytes())
    victims = sorted(p.name for p in source.parent.iterdir() if not p.name.endswith((".cpg", ".mtl")))
    generator = np.random.default_rng([12, number])
    for turn in range(MUTANTS):
        victim = victims[turn % len(victims)]
        data = (source.parent / victim).read_bytes()
        (tmp_path / victim).write_bytes(mutated(data, generator))
        started = time.process_time()
        with contextlib.suppress(RadarError):
            read(tmp_path / name)
        assert time.process_time() - started < LONGEST_S
        (tmp_path / victim).write_bytes(data)


def assert_refused(path, *words):
    with pytest.raises(RadarError) as caught:
        read(path)
    for word in words:
        assert word in str(caught.value)
    return str(caught.value)


def ply(**counts):
    rows = {
        "vertex": "property float x\nproperty float y\nproperty float z\n",
        "face": "property list uchar int vertex_indices\n",
    }
    body = "".join(f"element {name} {counts[name]}\n{rows[name]}" for name in rows)
    return f"ply\nformat binary_little_endian 1.0\n{body}end_header\n".encode()


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.ply", ply(vertex=10**12, face=1), "claims 1,000,000,000,000 rows of vertex and has only 0 bytes"),
        ("a.ply", ply(vertex=0, face=10**12) + b"\x03", "claims 1,000,000,000,000 rows of face"),
        ("a.ply", ply(vertex=1, face=1) + bytes(12) + b"\xff" + bytes(8), "ends in row 1 of 1 of face"),
        ("a.stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(50), "claims 4,294,967,295 triangles"),
        ("a.glb", b"glTF" + struct.pack("<II", 2, 2**32 - 1), "claims 4,294,967,295 bytes"),
        ("a.glb", b"glTF" + struct.pack("<III4s", 2, 20, 2**31, b"JSON"), "a chunk of 2,147,483,648 bytes"),
        ("a.obj", b"v 1 2 3\nf 1 2 99999999999999999999\n", "line 2 reads 'f 1 2 99999999999999999999'"),
        ("a.obj", b"v 1 2 3\nv 1 2 4\nv 4 2 1\nf 1 2 -9\n", "has 1 of 3 indices beyond its 3 vertices"),
        ("a.obj", b"v 1 2 x\n", "line 1 reads 'v 1 2 x'"),
        ("a.gltf", b'{"asset": {"version": "2.0"}, "nodes": ' + b"[" * 100_000, "is not glTF"),
        ("a.geojson", b'{"type": "FeatureCollection", "features": ' + b"[" * 100_000, "is not GeoJSON"),
        ("a.geojson", b'<VRTDataset rasterXSize="1"/>', "is not a GeoJSON, GeoPackage or Shapefile"),
        ("a.shp", b"<OGRVRTDataSource/>", "is not a GeoJSON, GeoPackage or Shapefile"),
        ("a.gpkg", b"SQLite format 3\0" + bytes(100), "is not a GeoJSON, GeoPackage or Shapefile"),
        ("a.geojson", b'{"type": "gdal_streamed_alg", "command_line": "gdal vector pipeline ! read /etc/passwd"}', ""),
    ],
)  # fmt: skip
def test_headers_that_lie_and_files_that_pose_as_others_cost_nothing(name, data, words, tmp_path):
    (tmp_path / name).write_bytes(data)
    for _ in range(2):  # the first one loads what reads it
        started = time.process_time()
        try:
            assert_refused(tmp_path / name, words)
        except pytest.fail.Exception:
            assert not words  # it has no polygon
    assert time.process_time() - started < 1.0


def accessor(count, **more):
    return {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"componentType": 5126, "count": count, "type": "VEC3", **more}],
        "bufferViews": [{"buffer": 0, "byteLength": 2**39}],
        "buffers": [{"byteLength": 2**39, "uri": "data:application/octet-stream;base64,AAAA"}],
    }


@pytest.mark.parametrize(
    ("document", "words"),
    [
        (accessor(10**12), "has 1,000,000,000,000 rows in accessors[0], more than"),
        (accessor(10**12, bufferView=0), "has 1,000,000,000,000 rows in accessors[0], more than"),
        (accessor(10**6, bufferView=0), "beyond the 3 bytes of its buffer"),
        (accessor(3, bufferView=0, byteOffset=-100), "an invalid offset or count"),
        (accessor(True, bufferView=0), "an invalid offset or count"),
    ],
)
def test_accessors_that_lie_cost_nothing(document, words, tmp_path):
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    assert_refused(tmp_path / "a.gltf", words)


BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    "text",
    [
        f'{BOMB}]><scene version="3">&i;</scene>',
        '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><scene version="3">&a;</scene>',
        '<!DOCTYPE scene SYSTEM "http://127.0.0.1:9/x.dtd"><scene version="3"/>',
    ],
)
def test_entities_are_refused(text, tmp_path):
    (tmp_path / "a.xml").write_text(text)
    assert_refused(tmp_path / "a.xml", "document type or entities")


def test_a_scene_nested_without_end_is_refused(tmp_path):
    depth = 100_000
    inner = '<bsdf type="twosided">' * depth + "</bsdf>" * depth
    (tmp_path / "a.xml").write_text(f'<scene version="3"><shape type="cube">{inner}</shape></scene>')
    assert_refused(tmp_path / "a.xml", "line 1 lies more than 50 elements deep")


ELSEWHERE = [
    "../ball.ply",
    "/etc/ball.ply",
    "http://127.0.0.1:9/ball.ply",
    "file:///etc/ball.ply",
    "..\\ball.ply",
    "link.ply",
]


@pytest.mark.parametrize("name", [*ELSEWHERE, "\0", ""])
def test_nothing_is_read_outside_the_folder_of_the_file(name, tmp_path):
    """A sound mesh lies there, so that only the refusal keeps it from being read; a link leads there, too."""
    inner = tmp_path / "inner"
    inner.mkdir()
    trimesh.creation.box().export(tmp_path / "ball.ply")
    (tmp_path / "ball.bin").write_bytes(bytes(36))
    (inner / "link.ply").symlink_to(tmp_path / "ball.ply")
    document = accessor(3, bufferView=0)
    document["bufferViews"][0]["byteLength"] = 36
    document["buffers"] = [{"byteLength": 36, "uri": name.replace(".ply", ".bin") if "link" not in name else name}]
    (inner / "a.gltf").write_text(json.dumps(document))
    assert_refused(inner / "a.gltf", "buffers[0] names", "own folder")
    if "\0" not in name:
        (inner / "a.xml").write_text(
            f'<scene version="3"><shape type="ply"><string name="filename" value="{name}"/></shape></scene>'
        )
        assert_refused(inner / "a.xml", "line 1 names", "own folder")


def test_the_mtl_of_an_obj_is_never_opened(tmp_path):
    """A pipe would never end."""
    os.mkfifo(tmp_path / "a.mtl")
    (tmp_path / "a.obj").write_text(
        "mtllib a.mtl\nmtllib ../../etc/passwd\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n"
    )
    assert as_mesh(tmp_path / "a.obj") == 1


def test_a_pipe_beside_a_shapefile_is_refused(sound, tmp_path):
    for other in sound["a.shp"].parent.iterdir():
        (tmp_path / other.name).write_bytes(other.read_bytes())
    (tmp_path / "a.dbf").unlink()
    os.mkfifo(tmp_path / "a.dbf")
    assert_refused(tmp_path / "a.shp", "a.dbf is a device, pipe or socket")


@pytest.mark.parametrize(
    "path", ["/vsicurl/http://127.0.0.1:9/a.geojson", "/vsizip/a.zip/a.shp", "http://127.0.0.1:9/a.gpkg"]
)
def test_paths_of_gdal_s_own_are_no_files(path):
    assert_refused(Path(path), "does not exist")


@pytest.mark.parametrize(
    "made",
    [
        "CREATE VIEW a AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i fid, NULL FROM n",
        "CREATE VIRTUAL TABLE a USING rtree(fid, x0, x1)",
    ],
    ids=["an endless view", "a virtual table"],
)
def test_a_geopackage_of_no_plain_tables_is_refused(made, sound, tmp_path):
    (tmp_path / "a.gpkg").write_bytes(sound["a.gpkg"].read_bytes())
    database = sqlite3.connect(tmp_path / "a.gpkg")
    # Triggers of the format call functions that only GDAL has.
    for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
        database.execute(f'DROP TRIGGER "{name}"')
    database.execute("DROP TABLE a")
    database.execute(made)
    database.commit()
    database.close()
    assert_refused(tmp_path / "a.gpkg", "the layer 'a', which is not a plain table")
