"""glTF 2.0 scenes, binary (GLB) and text: read by trimesh, which is given nodes, triangles and names of materials only.

It reads every accessor there is, so each is held against the bytes of its buffer before, and ends no circle of nodes.
What it passes over without a word is refused: fans, `normalized` and sparse accessors, and nodes below two others.

Source: Khronos Group 2021, "glTF 2.0 Specification".
"""

import base64
import binascii
import json
from pathlib import Path
from typing import Any

from sionna_radar.foundation.input_file import shown
from sionna_radar.scene.mesh_files.by_trimesh import read_by_trimesh
from sionna_radar.scene.mesh_files.part import (
    MOST_BYTES,
    MOST_FACES,
    MOST_PARTS,
    MOST_TEXT_BYTES,
    MOST_VERTICES,
    MeshError,
    MeshPart,
    beside,
    check_count,
)

MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"
DEEPEST_NODES = 100
# Accessors may share bytes: in sum they may be so many times those there are, and a few more.
MOST_REUSE, SMALL_BYTES = 10, 1_000_000
COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
TRIANGLES, STRIP, FAN = 4, 5, 6
# Extensions that the places of triangles depend on; those of materials, textures and lights do not matter here.
PLACES_CHANGED_BY = (
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "EXT_mesh_gpu_instancing",
)
KEPT = ("asset", "scene", "scenes", "nodes", "meshes", "accessors", "bufferViews")


def read_gltf(path: Path) -> tuple[MeshPart, ...]:
    """Return the triangles of a GLB or glTF file, one part for each primitive of each node; raises MeshError."""
    document, binary = _document(path)
    changed = sorted({*document.get("extensionsUsed", ()), *document.get("extensionsRequired", ())})
    changed = [name for name in changed if name in PLACES_CHANGED_BY]
    if changed:
        message = f"uses {', '.join(changed)}; export it without compression and without instances"
        raise MeshError(message)
    shown_meshes = _check_nodes(document)
    buffers = {
        f"{number}": binary if buffer.get("uri") is None else _bytes_of(path, str(buffer["uri"]), f"buffers[{number}]")
        for number, buffer in enumerate(document.get("buffers", []))
    }
    sizes = [len(data) for data in buffers.values()]
    _check_accessors(document, sizes)
    _check_meshes(document, shown_meshes)
    reduced = {key: document[key] for key in KEPT if key in document}
    reduced["materials"] = [{"name": str(m.get("name") or "")} for m in document.get("materials", [])]
    reduced["buffers"] = [{"uri": name} for name in buffers]
    return read_by_trimesh(json.dumps(reduced).encode(), "gltf", buffers)


def _document(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the JSON of a file and the binary chunk that comes with it."""
    data = path.read_bytes()
    binary = b""
    text = data
    if data[:4] == MAGIC:
        length = int.from_bytes(data[8:12], "little")
        if length > len(data) or int.from_bytes(data[4:8], "little") != 2:
            message = f"claims {length:,} bytes of version 2 and has {len(data):,} bytes; get the whole file"
            raise MeshError(message)
        chunks: dict[bytes, bytes] = {}
        at = 12
        while at + 8 <= length:
            size, kind = int.from_bytes(data[at : at + 4], "little"), data[at + 4 : at + 8]
            if at + 8 + size > length:
                message = f"claims a chunk of {size:,} bytes where {length - at - 8:,} are left; get the whole file"
                raise MeshError(message)
            chunks.setdefault(kind, data[at + 8 : at + 8 + size])
            at += 8 + size
        text, binary = chunks.get(JSON_CHUNK, b""), chunks.get(BINARY_CHUNK, b"")
    if len(text) > MOST_TEXT_BYTES:
        message = f"has {len(text):,} bytes of JSON, more than {MOST_TEXT_BYTES:,}; save it as GLB"
        raise MeshError(message)
    try:
        document = json.loads(text.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        message = f"has no glTF in it ({str(error)[:80] or 'nested too deeply'}); give a GLB or glTF 2.0 file"
        raise MeshError(message) from error
    if not isinstance(document, dict) or not isinstance(document.get("asset"), dict):
        message = "has no glTF in it; give a GLB or glTF 2.0 file"
        raise MeshError(message)
    if str(document["asset"].get("version", "")).split(".")[0] != "2":
        message = f"is of glTF version {shown(document['asset'].get('version'))}; convert it to 2.0"
        raise MeshError(message)
    return document, binary


def _entry(document: dict[str, Any], kind: str, number: Any) -> dict[str, Any]:
    entries = document.get(kind)
    if not isinstance(entries, list) or not isinstance(number, int) or not 0 <= number < len(entries):
        message = f"refers to {kind}[{shown(number)}], which it does not have; export it again"
        raise MeshError(message)
    return dict(entries[number])


def _check_nodes(document: dict[str, Any]) -> list[int]:
    """Reduce the nodes to a tree of places, and return the meshes that they show."""
    nodes = document.get("nodes", [])
    if not document.get("scenes"):
        children = {child for node in nodes for child in node.get("children", [])}
        document["scenes"] = [{"nodes": [number for number in range(len(nodes)) if number not in children]}]
        document["scene"] = 0
    waiting = [(root, 0) for root in _entry(document, "scenes", document.get("scene", 0)).get("nodes", [])]
    seen: set[int] = set()
    meshes = []
    while waiting:
        number, depth = waiting.pop()
        node = _entry(document, "nodes", number)
        if number in seen or depth > DEEPEST_NODES:
            message = f"nests its nodes more than {DEEPEST_NODES} deep, twice, or in a circle; export it again"
            raise MeshError(message)
        seen.add(number)
        check_count(len(seen), MOST_PARTS, "nodes")
        waiting += [(child, depth + 1) for child in node.get("children", [])]
        places = ("matrix",) if "matrix" in node else ("translation", "rotation", "scale")
        nodes[number] = {key: node[key] for key in (*places, "children", "mesh") if key in node}
        if "mesh" in node:
            mesh = _entry(document, "meshes", node["mesh"])
            document["meshes"][node["mesh"]] = {"name": node.get("name") or "", **mesh}
            meshes.append(node["mesh"])
    return meshes


def _check_accessors(document: dict[str, Any], sizes: list[int]) -> None:
    """Refuse accessors and views of more than the bytes there are, or of far more in sum."""
    views = document.setdefault("bufferViews", [])
    total = 0
    for number, accessor in enumerate(document.setdefault("accessors", [])):
        count, start, where = accessor["count"], accessor.get("byteOffset", 0), f"accessors[{number}]"
        row = WIDTHS[accessor["type"]] * COMPONENT_BYTES[accessor["componentType"]]
        if not (_is_count(count) and _is_count(start)):
            message = f"has {where} with a place or a count that is no number of bytes or rows; export it again"
            raise MeshError(message)
        check_count(count, 3 * MOST_FACES, f"rows in {where}")
        total += count * row
        if "bufferView" not in accessor:
            continue
        view = _entry(document, "bufferViews", accessor["bufferView"])
        step, length = view.get("byteStride", row), view["byteLength"]
        if not _is_count(step) or step < row or start + (count - 1) * step + row > length:
            message = f"has {where} of {count:,} rows, beyond the {length:,} bytes of its view; get the whole file"
            raise MeshError(message)
    for number, view in enumerate(views):
        have, length = sizes[view["buffer"]], view["byteLength"]
        if (
            not _is_count(length)
            or not _is_count(view.get("byteOffset", 0))
            or view.get("byteOffset", 0) + length > have
        ):
            message = f"has bufferViews[{number}], beyond the {have:,} bytes of its buffer; get the whole file"
            raise MeshError(message)
        total += length
    check_count(total, MOST_REUSE * sum(sizes) + SMALL_BYTES, "bytes in its accessors and their views")


def _check_meshes(document: dict[str, Any], meshes: list[int]) -> None:
    """Reduce the primitives to triangles, and refuse those that would be read wrongly."""
    vertices = {}
    for number, mesh in enumerate(document.get("meshes", [])):
        found = [p for p in mesh["primitives"] if p.get("mode", TRIANGLES) in (TRIANGLES, STRIP, FAN)]
        found = [p for p in found if "POSITION" in p["attributes"]]
        used = [(p["attributes"]["POSITION"], "VEC3") for p in found]
        indices = [(p["indices"], "SCALAR") for p in found if "indices" in p]
        for accessor, kind in (*used, *indices):
            rows = _entry(document, "accessors", accessor)
            if rows["type"] != kind or "sparse" in rows or "bufferView" not in rows or rows.get("normalized"):
                message = (
                    f"has accessors[{accessor}] that is sparse, normalized or no {kind}; export it as plain numbers"
                )
                raise MeshError(message)
        if any(p.get("mode") == FAN for p in found):
            message = f"has a fan of triangles in meshes[{number}]; export it as plain triangles"
            raise MeshError(message)
        kept = [{k: p[k] for k in ("indices", "material", "mode") if k in p} for p in found]
        for primitive, (place, _) in zip(kept, used, strict=True):
            primitive["attributes"] = {"POSITION": place}
        document["meshes"][number] = {"primitives": kept, "extras": {"name": str(mesh.get("name") or "")}}
        vertices[number] = sum(document["accessors"][place]["count"] for place, _ in used)
    check_count(sum(vertices[number] for number in meshes), MOST_VERTICES, "vertices")


def _bytes_of(path: Path, uri: str, place: str) -> bytes:
    """Return the bytes that a URI stands for: its own, or a file of the same folder."""
    from urllib.parse import unquote

    if uri.startswith("data:"):
        head, comma, text = uri.partition(",")
        try:
            return base64.b64decode(text, validate=True) if comma and head.endswith(";base64") else b""
        except (binascii.Error, ValueError) as error:
            message = f"has data in {place} that is not base64; export it again"
            raise MeshError(message) from error
    found = beside(path, unquote(uri), place)
    if not found.is_file() or found.stat().st_size > MOST_BYTES:
        message = f"{place} names {shown(uri)}, no file of at most {MOST_BYTES:,} bytes beside it; put it there"
        raise MeshError(message)
    return found.read_bytes()


def _is_count(number: Any) -> bool:
    return isinstance(number, int) and not isinstance(number, bool) and 0 <= number < 2**40
