"""Stanford polygon files, read here: libraries fail on polygons, on text or on faces with more than their corners.

Trimesh refuses binary files of triangles and quadrangles, cuts concave ones along the diagonal that lies outside them,
and rounds text to the header's float32, which is 0.25 m at a northing of 5,000 km. meshio 5.3 rounds text so, too, and
fails on faces with a property beside their corners, and on corners called `vertex_index`.
"""

import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Int

from sionna_radar.foundation.input_file import shown
from sionna_radar.scene.mesh_files.part import (
    MAX_FACES,
    MAX_TEXT_BYTES,
    MAX_VERTICES,
    MeshError,
    MeshPart,
    check_count,
    triangles_of,
)

MAX_HEADER_BYTES = 65_536
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"}
TYPES |= {"int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8"}
INDEX_LISTS = ("vertex_indices", "vertex_index")


CODES = {"i1": "b", "i2": "h", "i4": "i", "i8": "q", "u1": "B", "u2": "H", "u4": "I", "u8": "Q", "f8": "d"}
# Numbers of a text are held as these, whatever its header says.
TEXT = np.dtype("<f8")


@dataclass(frozen=True, kw_only=True)
class _Property:
    """One property of an element: its type, and that of its count if it is a list."""

    name: str
    kind: np.dtype
    count_kind: np.dtype | None = None


@dataclass(kw_only=True)
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    def row(self, items: int) -> np.dtype:
        """Return the layout of a row whose lists have so many items, columns named by their number."""
        columns: list[tuple[str, np.dtype] | tuple[str, np.dtype, int]] = []
        for place, given in enumerate(self.properties):
            if given.count_kind:
                columns += [(f"count-{place}", given.count_kind), (f"{place}", given.kind, items)]
            else:
                columns.append((f"{place}", given.kind))
        return np.dtype(columns)

    def index(self, *names: str) -> int:
        """Return the index of the property with one of some names; raises MeshError."""
        for place, given in enumerate(self.properties):
            if given.name in names:
                return place
        message = f"has no property {names[0]} of its element {self.name}; export the mesh again"
        raise MeshError(message)


def read_ply(path: Path) -> tuple[MeshPart, ...]:
    """Return the triangles of a PLY file; raises MeshError."""
    data = path.read_bytes()
    text, elements, start = _header(data)
    if text and len(data) > MAX_TEXT_BYTES:
        message = f"has {len(data):,} bytes of text, more than {MAX_TEXT_BYTES:,}; save it as binary PLY"
        raise MeshError(message)
    _check_counts(elements, len(data) - start, text)
    return _read_polygons(elements, _numbers(elements, data[start:]) if text else data[start:])


def _header(data: bytes) -> tuple[bool, list[_Element], int]:
    """Return whether the rows are text, the elements, and where their rows begin."""
    head, found, _ = data[:MAX_HEADER_BYTES].partition(b"end_header")
    end = data.find(b"\n", len(head))
    if not head.startswith(b"ply") or not found or end < 0:
        message = "has no PLY header; give a PLY file"
        raise MeshError(message)
    order: str | None = None
    elements: list[_Element] = []
    # Lines of any other beginning are comments; some writers break these into several.
    for number, line in enumerate(head.decode("ascii", "replace").splitlines(), 1):
        match line.split():
            case ["format", name, *_] if name in FORMATS and not elements:
                order = FORMATS[name]
            case ["element", name, count] if order is not None and count.isdecimal() and len(count) < 19:
                elements.append(_Element(name=name, count=int(count)))
            case ["property", *kinds, name] if elements and name not in [p.name for p in elements[-1].properties]:
                elements[-1].properties.append(_property(name, kinds, str(order), f"line {number}"))
            case ["element" | "property" | "format", *_]:
                message = f"line {number} of its header reads {shown(line)}; export the mesh again"
                raise MeshError(message)
    return not order, elements, end + 1


def _property(name: str, kinds: list[str], order: str, place: str) -> _Property:
    words = kinds[1:] if kinds[:1] == ["list"] else kinds
    if len(words) != 1 + (words is not kinds) or any(word not in TYPES for word in words):
        message = f"{place} of its header has a property of {shown(' '.join(kinds))}; export the mesh again"
        raise MeshError(message)
    if len(words) == 2 and TYPES[words[0]].startswith("f"):
        message = f"{place} counts in {words[0]}; export the mesh again"
        raise MeshError(message)
    *counted, kind = [np.dtype(order + TYPES[word]) if order else TEXT for word in words]
    return _Property(name=name, kind=kind, count_kind=counted[0] if counted else None)


def _check_counts(elements: list[_Element], size: int, text: bool) -> None:
    """Refuse a header that claims more rows than the file has bytes for, or than can be used."""
    for element in elements:
        if element.name == "vertex" and any(p.count_kind for p in element.properties):
            message = "has lists in its vertices; export the mesh again"
            raise MeshError(message)
        least = 2 * len(element.properties) if text else element.row(0).itemsize
        if element.count * max(least, 1) - text > size:
            message = f"claims {element.count:,} rows of {element.name} and has only {size:,} bytes; get the whole file"
            raise MeshError(message)
        check_count(element.count, MAX_VERTICES if element.name == "vertex" else MAX_FACES, f"rows of {element.name}")


def _numbers(elements: list[_Element], text: bytes) -> bytes:
    """Return the rows of a text as those of a binary file; what some writers add to a row is left out."""
    lines = (line for line in text.splitlines() if not line.isspace() and line)
    found = []
    for element in elements:
        lists = any(p.count_kind for p in element.properties)
        for number in range(element.count):
            row = np.array(next(lines, b"").split(), dtype=TEXT)
            width = 0 if lists else len(element.properties)
            for given in element.properties if lists else ():
                width += 1 + (int(row[width]) if given.count_kind and width < len(row) else 0)
            if width > len(row) or (width < len(row) and not lists):
                message = f"has {len(row)} numbers in row {number + 1:,} of {element.count:,} of {element.name}, "
                message += f"not {width}; get the whole file"
                raise MeshError(message)
            found.append(row[:width].tobytes())
    return b"".join(found)


def _read_polygons(elements: list[_Element], rows: bytes) -> tuple[MeshPart, ...]:
    """Return the triangles of rows that hold any polygons."""
    at, vertices, polygons = 0, None, None
    for element in elements:
        if element.name == "vertex":
            kind, axes = element.row(0), [element.index(axis) for axis in "xyz"]
            found = np.frombuffer(rows, kind, element.count, at)
            vertices = np.column_stack([found[f"{axis}"].astype(np.float64) for axis in axes])
            at += found.nbytes
        elif element.name == "face":
            *polygons, at = _lists(element, element.index(*INDEX_LISTS), rows, at)
        else:
            *_, at = _lists(element, -1, rows, at)
    if vertices is None or polygons is None:
        message = "has no faces (points alone are no surface); give a mesh of triangles"
        raise MeshError(message)
    return (MeshPart(name="", vertices=vertices, faces=triangles_of(vertices, *polygons)),)


def _lists(
    element: _Element, wanted: int, rows: bytes, at: int
) -> tuple[Int[np.ndarray, " row"], Int[np.ndarray, " item"], int]:
    """Return the lengths and the items of one property's lists in the rows that begin at a byte, and where they end."""
    triangles = element.row(3)
    lists = wanted < 0 or element.properties[wanted].count_kind is not None
    if lists and at + element.count * triangles.itemsize <= len(rows):
        found = np.frombuffer(rows, triangles, element.count, at)
        if all(np.all(found[name] == 3) for name in triangles.names or () if name.startswith("count-")):
            corners = found[f"{wanted}"].ravel() if wanted >= 0 else np.zeros(0)
            return np.full(element.count, 3), _whole(corners), at + found.nbytes
    size, items = [], []
    steps = []  # for each property the code of its count, if it is a list, and the bytes of one item
    for given in element.properties:
        kind = given.count_kind
        code = None if kind is None else struct.Struct((">" if kind.str[0] == ">" else "<") + CODES[kind.str[1:]])
        steps.append((code, given.kind.itemsize))
    for number in range(element.count):
        for place, (code, width) in enumerate(steps):
            begin, count = at, 1
            if code:
                begin += code.size
                given_count = code.unpack_from(rows, at)[0] if begin <= len(rows) else -1
                count = int(given_count) if given_count == int(given_count) else -1
            at = begin + count * width
            if count < 0 or at > len(rows):
                message = f"ends in row {number + 1:,} of {element.count:,} of {element.name}; get the whole file"
                raise MeshError(message)
            if place == wanted:
                size.append(count)
                items.append(rows[begin:at])
    listed = np.frombuffer(b"".join(items), element.properties[wanted].kind if wanted >= 0 else TEXT)
    return np.array(size, dtype=np.int64), _whole(listed), at


def _whole(found: np.ndarray) -> Int[np.ndarray, " item"]:
    """Return indices as whole numbers; raises MeshError for others."""
    whole: Int[np.ndarray, " item"] = found.astype(np.int64)
    if np.any(whole != found):
        message = f"has {np.count_nonzero(whole != found):,} indices that are no whole numbers; export the mesh again"
        raise MeshError(message)
    return whole
