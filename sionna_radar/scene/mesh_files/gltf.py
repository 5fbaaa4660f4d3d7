"""Reader of glTF 2.0 scenes, binary (GLB) and text, by trimesh from a document reduced to triangles and materials.

Trimesh does not check accessors against their buffers or nodes for cycles, so both are checked before. Features that it
silently ignores are rejected: fans, `normalized` and sparse accessors, and nodes with two parents.

Source: Khronos Group 2021, "glTF 2.0 Specification".
"""

import base64
import binascii
import json
from pathlib import Path
from typing import Any

from sionna_radar.foundation.input_file import shown
from sionna_radar.scene.mesh_files.part import (
    MAX_BYTES,
    MAX_FACES,
    MAX_PARTS,
    MAX_TEXT_BYTES,
    MAX_VERTICES,
    MeshError,
    MeshPart,
    check_count,
    file_in_same_folder,
    read_by_trimesh,
)

MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"
DEEPEST_NODES = 100
# Accessors may share bytes: largest total size, relative to that of the buffers, plus an allowance.
MAX_REUSE, SMALL_BYTES = 10, 1_000_000
COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
TRIANGLES, STRIP, FAN = 4, 5, 6
# Extensions that affect vertex positions; those of materials, textures and lights are ignored.
PLACES_CHANGED_BY = (
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "EXT_mesh_gpu_instancing",
)


def read_gltf(path: Path) -> tuple[MeshPart, ...]:
    """Return the triangles of a GLB or glTF file, one part for each primitive of each node; raises MeshError."""
    document, binary = _document(path)
    changed = sorted({*document.get("extensionsUsed", ()), *document.get("extensionsRequired", ())})
    changed = [name for name in changed if name in PLACES_CHANGED_BY]
    if changed:
        raise MeshError(f"uses {', '.join(changed)}; export it without compression and without instances")
    buffers: dict[str, bytes] = {}
    total = 0
    for number, buffer in enumerate(document.get("buffers", [])):
        uri = buffer.get("uri")
        buffers[f"{number}"] = binary if uri is None else _bytes_of(path, str(uri), f"buffers[{number}]")
        total += len(buffers[f"{number}"])
        check_count(total, MAX_BYTES, "bytes in its buffers")
    _check_accessors(document, [len(data) for data in buffers.values()])
    meshes = _meshes(document)
    roots, nodes, shown_meshes = _tree(document, meshes)
    reduced = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": roots}],
        "nodes": nodes,
        "meshes": shown_meshes,
        "materials": [{"name": str(m.get("name") or "")} for m in document.get("materials", [])],
        "accessors": document["accessors"],
        "bufferViews": document["bufferViews"],
        "buffers": [{"uri": name} for name in buffers],
    }
    return read_by_trimesh(json.dumps(reduced).encode(), "gltf", buffers)


def _document(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the JSON of a file and its binary chunk."""
    data = path.read_bytes()
    binary = b""
    text = data
    if data[:4] == MAGIC:
        length = int.from_bytes(data[8:12], "little")
        if length > len(data) or int.from_bytes(data[4:8], "little") != 2:
            raise MeshError(f"claims {length:,} bytes of version 2 and has {len(data):,} bytes; get the whole file")
        chunks: dict[bytes, bytes] = {}
        offset = 12
        while offset + 8 <= length:
            size, kind = int.from_bytes(data[offset : offset + 4], "little"), data[offset + 4 : offset + 8]
            if offset + 8 + size > length:
                message = f"claims a chunk of {size:,} bytes where {length - offset - 8:,} are left; get the whole file"
                raise MeshError(message)
            chunks.setdefault(kind, data[offset + 8 : offset + 8 + size])
            offset += 8 + size
        text, binary = chunks.get(JSON_CHUNK, b""), chunks.get(BINARY_CHUNK, b"")
    if len(text) > MAX_TEXT_BYTES:
        raise MeshError(f"has {len(text):,} bytes of JSON, more than {MAX_TEXT_BYTES:,}; save it as GLB")
    try:
        document = json.loads(text.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        message = f"is not glTF ({str(error)[:80] or 'nested too deeply'}); give a GLB or glTF 2.0 file"
        raise MeshError(message) from error
    if not isinstance(document, dict) or not isinstance(document.get("asset"), dict):
        raise MeshError("is not glTF; give a GLB or glTF 2.0 file")
    if str(document["asset"].get("version", "")).split(".")[0] != "2":
        raise MeshError(f"is of glTF version {shown(document['asset'].get('version'))}; convert it to 2.0")
    return document, binary


def _entry(document: dict[str, Any], kind: str, number: Any) -> dict[str, Any]:
    entries = document.get(kind)
    if not isinstance(entries, list) or not isinstance(number, int) or not 0 <= number < len(entries):
        raise MeshError(f"refers to {kind}[{shown(number)}], which it does not have; export it again")
    return dict(entries[number])


def _check_accessors(document: dict[str, Any], sizes: list[int]) -> None:
    """Reject accessors and views that exceed their buffers, or exceed them by far in total."""
    views = document.setdefault("bufferViews", [])
    total = 0
    for number, accessor in enumerate(document.setdefault("accessors", [])):
        count, start, label = accessor["count"], accessor.get("byteOffset", 0), f"accessors[{number}]"
        row = WIDTHS[accessor["type"]] * COMPONENT_BYTES[accessor["componentType"]]
        if not (_is_count(count) and _is_count(start)):
            raise MeshError(f"has {label} with an invalid offset or count; export it again")
        check_count(count, 3 * MAX_FACES, f"rows in {label}")
        total += count * row
        if "bufferView" not in accessor:
            continue
        view = _entry(document, "bufferViews", accessor["bufferView"])
        step, length = view.get("byteStride", row), view["byteLength"]
        if not _is_count(step) or step < row or start + (count - 1) * step + row > length:
            message = f"has {label} of {count:,} rows, beyond the {length:,} bytes of its view; get the whole file"
            raise MeshError(message)
    for number, view in enumerate(views):
        available, length = sizes[view["buffer"]], view["byteLength"]
        if (
            not _is_count(length)
            or not _is_count(view.get("byteOffset", 0))
            or view.get("byteOffset", 0) + length > available
        ):
            message = f"has bufferViews[{number}], beyond the {available:,} bytes of its buffer; get the whole file"
            raise MeshError(message)
        total += length
    check_count(total, MAX_REUSE * sum(sizes) + SMALL_BYTES, "bytes in its accessors and their views")


def _meshes(document: dict[str, Any]) -> list[list[dict[str, Any]]]:
    """Return the triangle primitives of each mesh, reduced to positions and indices; reject unsupported ones."""
    primitives = []
    for number, mesh in enumerate(document.get("meshes", [])):
        primitives.append([p for p in mesh["primitives"] if p.get("mode", TRIANGLES) in (TRIANGLES, STRIP, FAN)])
        if any(p.get("mode") == FAN for p in primitives[-1]):
            raise MeshError(f"has a fan of triangles in meshes[{number}]; export it as plain triangles")
        primitives[-1] = [
            {"attributes": {"POSITION": p["attributes"]["POSITION"]}}
            | {key: p[key] for key in ("indices", "material", "mode") if key in p}
            for p in primitives[-1]
            if "POSITION" in p["attributes"]
        ]
        accessors = [(p["attributes"]["POSITION"], "VEC3") for p in primitives[-1]]
        for accessor, kind in (*accessors, *((p["indices"], "SCALAR") for p in primitives[-1] if "indices" in p)):
            rows = _entry(document, "accessors", accessor)
            if rows["type"] != kind or "sparse" in rows or "bufferView" not in rows or rows.get("normalized"):
                message = f"has accessors[{accessor}] that is sparse, normalized or no {kind}; export plain numbers"
                raise MeshError(message)
    return primitives


def _tree(
    document: dict[str, Any], meshes: list[list[dict[str, Any]]]
) -> tuple[list[int], list[dict[str, Any]], list[dict[str, Any]]]:
    """Return roots, nodes and meshes, with each primitive of a node's mesh as the mesh of a separate child node.

    Trimesh names the primitives of one mesh by random six-digit numbers, and loses duplicates. It visits the last child
    first, so that children are listed in reverse.
    """
    source = document.get("nodes", [])
    children_set = {child for node in source for child in node.get("children", [])}
    roots = [index for index in range(len(source)) if index not in children_set]
    if document.get("scenes"):
        roots = _entry(document, "scenes", document.get("scene", 0)).get("nodes", [])
    nodes: list[dict[str, Any]] = [{} for _ in source]
    parts: list[dict[str, Any]] = []
    stack, visited, vertices = [(root, 0) for root in reversed(roots)], set(), 0
    while stack:
        index, depth = stack.pop()
        node = _entry(document, "nodes", index)
        if index in visited or depth > DEEPEST_NODES:
            raise MeshError(f"nests its nodes more than {DEEPEST_NODES} deep, twice, or in a circle; export it again")
        visited.add(index)
        children = node.get("children", [])
        stack += [(child, depth + 1) for child in reversed(children)]
        transform_keys = ("matrix",) if "matrix" in node else ("translation", "rotation", "scale")
        nodes[index] = {key: node[key] for key in transform_keys if key in node} | {"children": children[::-1]}
        if node.get("mesh") is None:
            continue
        name = str(_entry(document, "meshes", node["mesh"]).get("name") or node.get("name") or "")
        for primitive in reversed(meshes[node["mesh"]]):
            nodes[index]["children"].append(len(nodes))
            nodes.append({"mesh": len(parts)})
            parts.append({"primitives": [primitive], "extras": {"name": name}})
            vertices += document["accessors"][primitive["attributes"]["POSITION"]]["count"]
        check_count(vertices, MAX_VERTICES, "vertices")
        check_count(len(parts), MAX_PARTS, "parts")
    return roots[::-1], nodes, parts


def _bytes_of(path: Path, uri: str, label: str) -> bytes:
    """Return the bytes of a URI: embedded data, or a file of the same folder."""
    from urllib.parse import unquote

    if uri.startswith("data:"):
        head, comma, text = uri.partition(",")
        try:
            return base64.b64decode(text, validate=True) if comma and head.endswith(";base64") else b""
        except (binascii.Error, ValueError) as error:
            raise MeshError(f"has data in {label} that is not base64; export it again") from error
    file = file_in_same_folder(path, unquote(uri), label)
    if not file.is_file() or file.stat().st_size > MAX_BYTES:
        raise MeshError(f"{label} names {shown(uri)}, no file of at most {MAX_BYTES:,} bytes beside it; put it there")
    return file.read_bytes()


def _is_count(number: Any) -> bool:
    return isinstance(number, int) and not isinstance(number, bool) and 0 <= number < 2**40
