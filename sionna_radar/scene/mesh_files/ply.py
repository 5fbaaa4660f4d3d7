"""Stanford polygon files (PLY). A reader of our own: libraries fail on polygons, text, or faces with extra properties.

Trimesh rejects binary files of mixed triangles and quadrangles, splits concave ones along the outer diagonal,
and rounds text to the header's float32, in steps of 0.25 m at a northing of 5,000 km. meshio 5.3 rounds text, too, and
fails on faces with extra properties, and on corners called `vertex_index`.
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
# Type of the numbers of a text file, regardless of its header.
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
        """Return the layout of a row whose lists have `items` items, with columns named by number."""
        columns: list[tuple[str, np.dtype] | tuple[str, np.dtype, int]] = []
        for column, property_ in enumerate(self.properties):
            if property_.count_kind:
                columns += [(f"count-{column}", property_.count_kind), (f"{column}", property_.kind, items)]
            else:
                columns.append((f"{column}", property_.kind))
        return np.dtype(columns)

    def index(self, *names: str) -> int:
        """Return the index of the property with one of some names; raises MeshError."""
        for column, property_ in enumerate(self.properties):
            if property_.name in names:
                return column
        raise MeshError(f"has no property {names[0]} of its element {self.name}; export the mesh again")


def read_ply(path: Path) -> tuple[MeshPart, ...]:
    """Return the triangles of a PLY file; raises MeshError."""
    data = path.read_bytes()
    text, elements, start = _header(data)
    if text and len(data) > MAX_TEXT_BYTES:
        raise MeshError(f"has {len(data):,} bytes of text, more than {MAX_TEXT_BYTES:,}; save it as binary PLY")
    _check_counts(elements, len(data) - start, text)
    return _read_polygons(elements, _numbers(elements, data[start:]) if text else data[start:])


def _header(data: bytes) -> tuple[bool, list[_Element], int]:
    """Return the form of the rows (True: text), the elements, and the offset of their rows."""
    head, terminator, _ = data[:MAX_HEADER_BYTES].partition(b"end_header")
    end = data.find(b"\n", len(head))
    if not head.startswith(b"ply") or not terminator or end < 0:
        raise MeshError("has no PLY header; give a PLY file")
    order: str | None = None
    elements: list[_Element] = []
    # All other lines are comments; some writers break these into several lines.
    for number, line in enumerate(head.decode("ascii", "replace").splitlines(), 1):
        match line.split():
            case ["format", name, *_] if name in FORMATS and not elements:
                order = FORMATS[name]
            case ["element", name, count] if order is not None and count.isdecimal() and len(count) < 19:
                elements.append(_Element(name=name, count=int(count)))
            case ["property", *kinds, name] if elements and name not in [p.name for p in elements[-1].properties]:
                elements[-1].properties.append(_property(name, kinds, str(order), f"line {number}"))
            case ["element" | "property" | "format", *_]:
                raise MeshError(f"line {number} of its header reads {shown(line)}; export the mesh again")
    return not order, elements, end + 1


def _property(name: str, kinds: list[str], order: str, label: str) -> _Property:
    words = kinds[1:] if kinds[:1] == ["list"] else kinds
    if len(words) != 1 + (words is not kinds) or any(word not in TYPES for word in words):
        raise MeshError(f"{label} of its header has a property of {shown(' '.join(kinds))}; export the mesh again")
    if len(words) == 2 and TYPES[words[0]].startswith("f"):
        raise MeshError(f"{label} counts in {words[0]}; export the mesh again")
    *counted, kind = [np.dtype(order + TYPES[word]) if order else TEXT for word in words]
    return _Property(name=name, kind=kind, count_kind=counted[0] if counted else None)


def _check_counts(elements: list[_Element], size: int, text: bool) -> None:
    """Reject a header that claims more rows than the file can hold, or than the limits allow."""
    for element in elements:
        if element.name == "vertex" and any(p.count_kind for p in element.properties):
            raise MeshError("has lists in its vertices; export the mesh again")
        min_bytes = 2 * len(element.properties) if text else element.row(0).itemsize
        if element.count * max(min_bytes, 1) - text > size:
            message = f"claims {element.count:,} rows of {element.name} and has only {size:,} bytes; get the whole file"
            raise MeshError(message)
        check_count(element.count, MAX_VERTICES if element.name == "vertex" else MAX_FACES, f"rows of {element.name}")


def _numbers(elements: list[_Element], text: bytes) -> bytes:
    """Convert the rows of a text file to binary ones, without extra numbers at their ends."""
    lines = (line for line in text.splitlines() if not line.isspace() and line)
    rows = []
    for element in elements:
        lists = any(p.count_kind for p in element.properties)
        for number in range(element.count):
            row = np.array(next(lines, b"").split(), dtype=TEXT)
            width = 0 if lists else len(element.properties)
            for property_ in element.properties if lists else ():
                width += 1 + (int(row[width]) if property_.count_kind and width < len(row) else 0)
            if width > len(row) or (width < len(row) and not lists):
                message = f"has {len(row)} numbers in row {number + 1:,} of {element.count:,} of {element.name}, "
                message += f"not {width}; get the whole file"
                raise MeshError(message)
            rows.append(row[:width].tobytes())
    return b"".join(rows)


def _read_polygons(elements: list[_Element], rows: bytes) -> tuple[MeshPart, ...]:
    """Return the triangles of rows of arbitrary polygons."""
    offset, vertices, polygons = 0, None, None
    for element in elements:
        if element.name == "vertex":
            kind, axes = element.row(0), [element.index(axis) for axis in "xyz"]
            table = np.frombuffer(rows, kind, element.count, offset)
            vertices = np.column_stack([table[f"{axis}"].astype(np.float64) for axis in axes])
            offset += table.nbytes
        elif element.name == "face":
            *polygons, offset = _lists(element, element.index(*INDEX_LISTS), rows, offset)
        else:
            *_, offset = _lists(element, -1, rows, offset)
    if vertices is None or polygons is None:
        raise MeshError("has no faces (a point cloud is not a surface); give a mesh of triangles")
    return (MeshPart(name="", vertices=vertices, faces=triangles_of(vertices, *polygons)),)


def _lists(
    element: _Element, selected: int, rows: bytes, offset: int
) -> tuple[Int[np.ndarray, " row"], Int[np.ndarray, " item"], int]:
    """Return the lengths and items of one property's lists in the rows from a byte offset, and the end offset."""
    triangles = element.row(3)
    lists = selected < 0 or element.properties[selected].count_kind is not None
    if lists and offset + element.count * triangles.itemsize <= len(rows):
        table = np.frombuffer(rows, triangles, element.count, offset)
        if all(np.all(table[name] == 3) for name in triangles.names or () if name.startswith("count-")):
            corners = table[f"{selected}"].ravel() if selected >= 0 else np.zeros(0)
            return np.full(element.count, 3), _whole(corners), offset + table.nbytes
    size, items = [], []
    steps = []  # per property: code of the count for a list, and bytes per item
    for property_ in element.properties:
        kind = property_.count_kind
        code = None if kind is None else struct.Struct((">" if kind.str[0] == ">" else "<") + CODES[kind.str[1:]])
        steps.append((code, property_.kind.itemsize))
    for number in range(element.count):
        for column, (code, width) in enumerate(steps):
            begin, count = offset, 1
            if code:
                begin += code.size
                stored_count = code.unpack_from(rows, offset)[0] if begin <= len(rows) else -1
                count = int(stored_count) if stored_count == int(stored_count) else -1
            offset = begin + count * width
            if count < 0 or offset > len(rows):
                message = f"ends in row {number + 1:,} of {element.count:,} of {element.name}; get the whole file"
                raise MeshError(message)
            if column == selected:
                size.append(count)
                items.append(rows[begin:offset])
    listed = np.frombuffer(b"".join(items), element.properties[selected].kind if selected >= 0 else TEXT)
    return np.array(size, dtype=np.int64), _whole(listed), offset


def _whole(values: np.ndarray) -> Int[np.ndarray, " item"]:
    """Return indices as whole numbers; raises MeshError for others."""
    integers: Int[np.ndarray, " item"] = values.astype(np.int64)
    if np.any(integers != values):
        raise MeshError(
            f"has {np.count_nonzero(integers != values):,} indices that are not whole numbers; export the mesh again"
        )
    return integers
