"""Readers of Wavefront OBJ meshes and, by trimesh, of stereolithography (STL) meshes.

The names of the materials of an OBJ mesh are in the file itself, so that its MTL is never opened. OBJ is not read by
trimesh, which loses the names without the MTL and vertices after a tab, counts negative indices from the end of the
file, and splits concave polygons as fans: `concave_polygon.obj` of assimp of 0.25 m2 becomes 3.2.

STL meshes, binary and text, are read by trimesh after a check of the file's length.
"""

import io
import re
from array import array
from pathlib import Path

import numpy as np

from sionna_radar.foundation.input_file import shown
from sionna_radar.scene.mesh_files.part import (
    MAX_FACES,
    MAX_PARTS,
    MAX_TEXT_BYTES,
    MAX_VERTICES,
    MeshError,
    MeshPart,
    check_count,
    read_by_trimesh,
    triangles_of,
)


def read_obj(path: Path) -> tuple[MeshPart, ...]:
    """Return the triangles of an OBJ file, one part for each material; raises MeshError."""
    size = path.stat().st_size
    if size > MAX_TEXT_BYTES:
        raise MeshError(f"has {size:,} bytes of text, more than {MAX_TEXT_BYTES:,}; save it as PLY or GLB")
    text = path.read_bytes().decode("utf-8", "replace").replace("\\\r\n", " ").replace("\\\n", " ")
    vertices, faces = _read_lines(text)
    if not faces:
        raise MeshError("has no faces; give a mesh of polygons")
    vertex_array = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    parts = []
    for name, polygons in faces.items():
        sides, corner = (np.array(numbers, dtype=np.int64) for numbers in polygons)
        triangles = triangles_of(vertex_array, sides, corner)
        kept_vertices, index = np.unique(triangles, return_inverse=True)
        parts.append(MeshPart(name=name, vertices=vertex_array[kept_vertices], faces=index.reshape(-1, 3)))
    return tuple(parts)


def _read_lines(text: str) -> tuple["array[float]", dict[str, tuple["array[int]", "array[int]"]]]:
    """Return the flat coordinates of all vertices, and of each material the corners' counts and indices of polygons."""
    vertices = array("d")
    faces: dict[str, tuple[array[int], array[int]]] = {}
    material = group = ""
    for number, line in enumerate(io.StringIO(text), 1):
        word, _, arguments = line.strip().replace("\t", " ").partition(" ")
        try:
            if word == "v":
                x, y, z = arguments.split()[:3]
                vertices.extend((float(x), float(y), float(z)))
            elif word == "f":
                sizes, indices = faces.setdefault(material or group, (array("q"), array("q")))
                corners = [int(c.partition("/")[0]) for c in arguments.partition("#")[0].split()]
                # Indices count from 1; negative ones count back from the vertex read last.
                indices.extend([c - 1 if c > 0 else len(vertices) // 3 + c if c else -1 for c in corners])
                sizes.append(len(corners))
            elif word == "usemtl":
                material = arguments.strip()
            elif word in ("o", "g"):
                group = arguments.strip()
        except (ValueError, OverflowError) as error:
            raise MeshError(f"line {number} reads {shown(line.strip())}; export the mesh again") from error
    check_count(len(vertices) // 3, MAX_VERTICES, "vertices")
    check_count(sum(len(sizes) for sizes, _ in faces.values()), MAX_FACES, "polygons")
    check_count(len(faces), MAX_PARTS, "materials")
    return vertices, faces


HEADER_BYTES, FACET_BYTES = 84, 50
SOLID = re.compile(rb"\s*solid\b", re.IGNORECASE)
VERTEX = re.compile(rb"^[ \t]*vertex(?:[ \t]+[^ \t\r\n]+){3}[ \t]*\r?$", re.MULTILINE | re.IGNORECASE)


def read_stl(path: Path) -> tuple[MeshPart, ...]:
    """Return the triangles of an STL file; raises MeshError."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEADER_BYTES)
        count = int.from_bytes(head[80:], "little") if len(head) == HEADER_BYTES else 0
        needed = HEADER_BYTES + count * FACET_BYTES
        text = size != needed
        if text and not SOLID.match(head):
            message = f"claims {count:,} triangles, which need {needed:,} bytes, and has {size:,}; get the whole file"
            raise MeshError(message)
        if text and size > MAX_TEXT_BYTES:
            raise MeshError(f"has {size:,} bytes of text, more than {MAX_TEXT_BYTES:,}; save it as binary STL")
        check_count(0 if text else count, MAX_FACES, "triangles")
        data = head + file.read()
    if text:
        data = data.decode("ascii", "replace").encode("utf-8")
        count = sum(1 for _ in VERTEX.finditer(data)) // 3
        check_count(count, MAX_FACES, "triangles")
    parts = read_by_trimesh(data, "stl")
    triangles = sum(len(part.faces) for part in parts)
    if triangles != count:  # trimesh skips an unterminated solid, and accepts a vertex of two or four numbers
        raise MeshError(f"has {count:,} triangles, of which {triangles:,} are whole; get the whole file")
    return tuple(MeshPart(name="", vertices=part.vertices, faces=part.faces) for part in parts)
