"""glTF 2.0 scenes, binary (GLB) and text; of everything in them only nodes, triangles and names of materials are read.

Source: Khronos Group 2021, "glTF 2.0 Specification".
"""

import base64
import binascii
import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from sionna_radar.foundation.input_file import shown
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
from sionna_radar.scene.mesh_files.polygons import check_indices

MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"
DEEPEST_NODES = 100
COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
TRIANGLES, STRIP, FAN = 4, 5, 6
# Extensions that the places of triangles depend on; those of materials, textures and lights do not matter here.
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
        message = f"uses {', '.join(changed)}; export it without compression and without instances"
        raise MeshError(message)
    return _Scene(path, document, binary).parts()


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


class _Scene:
    """The nodes of a document, walked from the roots of its scene."""

    def __init__(self, path: Path, document: dict[str, Any], binary: bytes) -> None:
        self._path, self._document, self._binary = path, document, binary
        self._buffers: dict[int, bytes] = {}
        self._vertices = self._faces = 0

    def parts(self) -> tuple[MeshPart, ...]:
        found: list[MeshPart] = []
        waiting = [(root, np.eye(4), 0) for root in reversed(self._roots())]
        visited = 0
        while waiting:
            number, outer, depth = waiting.pop()
            visited += 1
            check_count(visited, MOST_PARTS, "nodes")
            if depth > DEEPEST_NODES:
                message = f"nests its nodes more than {DEEPEST_NODES} deep, or in a circle; export it again"
                raise MeshError(message)
            node = self._entry("nodes", number)
            place = outer @ _matrix_of(node)
            if node.get("mesh") is not None:
                found += self._primitives(node["mesh"], place, str(node.get("name") or ""))
            waiting += [(child, place, depth + 1) for child in reversed(node.get("children", []))]
        if not found:
            message = "has no triangles; give a mesh of triangles"
            raise MeshError(message)
        return tuple(found)

    def _roots(self) -> list[int]:
        scenes = self._document.get("scenes") or []
        if scenes:
            return list(self._entry("scenes", self._document.get("scene") or 0).get("nodes", []))
        nodes = self._document.get("nodes", [])
        children = {child for node in nodes for child in node.get("children", [])}
        return [number for number in range(len(nodes)) if number not in children]

    def _entry(self, kind: str, number: Any) -> dict[str, Any]:
        entries = self._document.get(kind)
        if not isinstance(entries, list) or not isinstance(number, int) or not 0 <= number < len(entries):
            message = f"refers to {kind}[{shown(number)}], which it does not have; export it again"
            raise MeshError(message)
        entry = entries[number]
        if not isinstance(entry, dict):
            message = f"has {kind}[{number}] that is no object of JSON; export it again"
            raise MeshError(message)
        return entry

    def _primitives(self, mesh: Any, place: Float[np.ndarray, "4 4"], node: str) -> list[MeshPart]:
        parts = []
        described = self._entry("meshes", mesh)
        for primitive in described.get("primitives", []):
            mode = primitive.get("mode", TRIANGLES)
            if mode not in (TRIANGLES, STRIP, FAN) or "POSITION" not in primitive.get("attributes", {}):
                continue  # points and lines
            own = self._array(primitive["attributes"]["POSITION"], 3).astype(np.float64)
            indices = primitive.get("indices")
            index = np.arange(len(own)) if indices is None else self._array(indices, 1).astype(np.int64).ravel()
            check_indices(index, len(own))
            faces = _faces_of(index, mode)
            self._vertices, self._faces = self._vertices + len(own), self._faces + len(faces)
            check_count(self._vertices, MOST_VERTICES, "vertices")
            check_count(self._faces, MOST_FACES, "triangles")
            number = primitive.get("material")
            material = "" if number is None else str(self._entry("materials", number).get("name") or "")
            if np.linalg.det(place[:3, :3]) < 0:  # a mirrored copy
                faces = faces[:, ::-1]
            with np.errstate(invalid="ignore", over="ignore"):  # vertices that are no places are found later
                vertices = own @ place[:3, :3].T + place[:3, 3]
            name = material or str(described.get("name") or node)
            parts.append(MeshPart(name=name, vertices=vertices, faces=faces))
        return parts

    def _array(self, number: Any, width: int) -> np.ndarray:
        """Return the values of an accessor, one row each."""
        accessor = self._entry("accessors", number)
        kind, count, where = accessor.get("componentType"), accessor.get("count", 0), f"accessors[{number}]"
        if kind not in COMPONENTS or WIDTHS.get(accessor.get("type", "")) != width or not _is_count(count):
            message = f"has {where} that is not {width} number(s) a row; export it again"
            raise MeshError(message)
        if "sparse" in accessor or accessor.get("bufferView") is None:
            message = f"has {where} without all its values in one place; export it without sparse accessors"
            raise MeshError(message)
        check_count(count, MOST_VERTICES if width == 3 else 3 * MOST_FACES, f"rows in {where}")
        view = self._entry("bufferViews", accessor["bufferView"])
        data = self._buffer(view.get("buffer"))
        item = np.dtype(COMPONENTS[kind])
        start, step = view.get("byteOffset", 0), view.get("byteStride") or item.itemsize * width
        offset, length = accessor.get("byteOffset", 0), view.get("byteLength", 0)
        needed = offset + (count - 1) * step + item.itemsize * width if count else 0
        if not all(_is_count(n) for n in (start, step, offset, length)) or step < item.itemsize * width:
            message = f"has {where} with a place that is no number of bytes; export it again"
            raise MeshError(message)
        if needed > length or start + length > len(data):
            message = f"has {where} of {count:,} rows, beyond the {len(data):,} bytes of its buffer; get the whole file"
            raise MeshError(message)
        rows = np.ndarray((count, width), item, data, start + offset, (step, item.itemsize))
        if accessor.get("normalized") and item.kind in "iu":
            return np.maximum(rows / float(np.iinfo(item).max), -1.0)
        return rows

    def _buffer(self, number: Any) -> bytes:
        described = self._entry("buffers", number)
        if number not in self._buffers:
            uri = described.get("uri")
            self._buffers[number] = self._binary if uri is None else self._read(str(uri), f"buffers[{number}]")
        return self._buffers[number]

    def _read(self, uri: str, place: str) -> bytes:
        """Return the bytes that a URI stands for: its own, or a file of the same folder."""
        from urllib.parse import unquote

        if uri.startswith("data:"):
            head, comma, text = uri.partition(",")
            try:
                return base64.b64decode(text, validate=True) if comma and head.endswith(";base64") else b""
            except (binascii.Error, ValueError) as error:
                message = f"has data in {place} that is not base64; export it again"
                raise MeshError(message) from error
        found = beside(self._path, unquote(uri), place)
        if not found.is_file() or found.stat().st_size > MOST_BYTES:
            message = f"{place} names {shown(uri)}, no file of at most {MOST_BYTES:,} bytes beside it; put it there"
            raise MeshError(message)
        return found.read_bytes()


def _is_count(number: Any) -> bool:
    return isinstance(number, int) and not isinstance(number, bool) and 0 <= number < 2**40


def _matrix_of(node: dict[str, Any]) -> Float[np.ndarray, "4 4"]:
    """Return the transform of a node: its matrix, by columns, or its translation, rotation and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    place = np.eye(4)
    turn = np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), dtype=np.float64)
    scale = np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64).reshape(3)
    place[:3, :3] = Rotation.from_quat(turn).as_matrix() * scale
    place[:3, 3] = np.array(node.get("translation", (0.0, 0.0, 0.0)), dtype=np.float64).reshape(3)
    return place


def _faces_of(index: Int[np.ndarray, " n"], mode: int) -> Int[np.ndarray, "face 3"]:
    if mode == TRIANGLES:
        return index[: len(index) // 3 * 3].reshape(-1, 3)
    if len(index) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    if mode == FAN:
        return np.column_stack([np.full(len(index) - 2, index[0]), index[1:-1], index[2:]])
    strip = np.column_stack([index[:-2], index[1:-1], index[2:]])
    strip[1::2] = strip[1::2, [1, 0, 2]]
    return strip
