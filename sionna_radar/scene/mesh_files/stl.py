"""Stereolithography meshes, binary and text."""

import re
from pathlib import Path

import numpy as np

from sionna_radar.scene.mesh_files.part import MOST_FACES, MOST_TEXT_BYTES, MeshError, MeshPart, check_count

HEADER_BYTES, FACET_BYTES = 84, 50
FACET = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("attribute", "<u2")])
NUMBER = rb"[ \t]+([^ \t\r\n]+)"
VERTEX = re.compile(rb"^[ \t]*vertex" + 3 * NUMBER + rb"[ \t]*\r?$", re.MULTILINE | re.IGNORECASE)
SOLID = re.compile(rb"\s*solid\b", re.IGNORECASE)


def read_stl(path: Path) -> tuple[MeshPart, ...]:
    """Return the triangles of an STL file; raises MeshError."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEADER_BYTES)
        count = int.from_bytes(head[80:84], "little") if len(head) == HEADER_BYTES else 0
        if len(head) == HEADER_BYTES and HEADER_BYTES + count * FACET_BYTES == size:
            check_count(count, MOST_FACES, "triangles")
            corner = np.frombuffer(file.read(), dtype=FACET)["corner"].astype(np.float64)
        elif SOLID.match(head):
            if size > MOST_TEXT_BYTES:
                message = f"has {size:,} bytes of text, more than {MOST_TEXT_BYTES:,}; save it as binary STL"
                raise MeshError(message)
            corner = _text_corners(head + file.read())
        else:
            message = (
                f"claims {count:,} triangles, which need {HEADER_BYTES + count * FACET_BYTES:,} bytes, and has "
                f"{size:,}; get the whole file"
            )
            raise MeshError(message)
    vertices = corner.reshape(-1, 3)
    return (MeshPart(name="", vertices=vertices, faces=np.arange(len(vertices)).reshape(-1, 3)),)


def _text_corners(text: bytes) -> np.ndarray:
    found = VERTEX.findall(text)
    if len(found) % 3 or len(found) != len(re.findall(rb"^[ \t]*vertex\b", text, re.MULTILINE | re.IGNORECASE)):
        message = f"has {len(found):,} whole vertices, which are no triangles; get the whole file"
        raise MeshError(message)
    check_count(len(found) // 3, MOST_FACES, "triangles")
    return np.array(found, dtype="S40").astype(np.float64).reshape(-1, 3, 3)
