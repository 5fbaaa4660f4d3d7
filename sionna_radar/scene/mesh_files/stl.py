"""Stereolithography meshes, binary and text: read by trimesh, once the file is as long as it claims."""

import re
from pathlib import Path

from sionna_radar.scene.mesh_files.by_trimesh import read_by_trimesh
from sionna_radar.scene.mesh_files.part import MOST_FACES, MOST_TEXT_BYTES, MeshError, MeshPart, check_count

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
        if text and size > MOST_TEXT_BYTES:
            message = f"has {size:,} bytes of text, more than {MOST_TEXT_BYTES:,}; save it as binary STL"
            raise MeshError(message)
        check_count(0 if text else count, MOST_FACES, "triangles")
        data = head + file.read()
    if text:
        data = data.decode("ascii", "replace").encode("utf-8")
        count = sum(1 for _ in VERTEX.finditer(data)) // 3
        check_count(count, MOST_FACES, "triangles")
    parts = read_by_trimesh(data, "stl")
    found = sum(len(part.faces) for part in parts)
    if found != count:  # trimesh passes over a solid that does not end, and takes a vertex of two or four numbers
        message = f"has {count:,} triangles, of which {found:,} are whole; get the whole file"
        raise MeshError(message)
    return tuple(MeshPart(name="", vertices=part.vertices, faces=part.faces) for part in parts)
