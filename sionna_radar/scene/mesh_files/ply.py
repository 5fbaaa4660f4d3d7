"""Stanford polygon files, text and binary, of triangles or of any polygons."""

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.input_file import shown
from sionna_radar.scene.mesh_files.part import (
    MOST_FACES,
    MOST_TEXT_BYTES,
    MOST_VERTICES,
    MeshError,
    MeshPart,
    check_count,
)
from sionna_radar.scene.mesh_files.polygons import triangles_of

MOST_HEADER_BYTES = 65_536
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"}
TYPES |= {"int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8"}
INDEX_LISTS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True, kw_only=True)
class _Property:
    """One property of an element: its type, and that of its count if it is a list."""

    name: str
    kind: str
    count_kind: str | None = None

    @property
    def least_bytes(self) -> int:
        return np.dtype(self.count_kind or self.kind).itemsize


@dataclass(kw_only=True)
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    def index(self, *names: str) -> int:
        """Return which property has one of some names; raises MeshError."""
        for place, given in enumerate(self.properties):
            if given.name in names:
                return place
        message = f"has no property {names[0]} of its element {self.name}; export the mesh again"
        raise MeshError(message)


def read_ply(path: Path) -> tuple[MeshPart, ...]:
    """Return the triangles of a PLY file; raises MeshError."""
    data = path.read_bytes()
    order, elements, start = _header(data)
    _check_counts(elements, len(data) - start, order)
    if not order and len(data) > MOST_TEXT_BYTES:
        message = f"has {len(data):,} bytes of text, more than {MOST_TEXT_BYTES:,}; save it as binary PLY"
        raise MeshError(message)
    rows = _Text(data[start:]) if not order else _Binary(data, start, order)
    vertices, polygons = None, None
    for element in elements:
        if element.name == "vertex":
            axes = [element.index(axis) for axis in "xyz"]
            vertices = rows.numbers(element, axes)
        elif element.name == "face":
            polygons = rows.lists(element, element.index(*INDEX_LISTS))
        else:
            rows.skip(element)
        if vertices is not None and polygons is not None:
            return (MeshPart(name="", vertices=vertices, faces=triangles_of(vertices, *polygons)),)
    message = "has no faces (points alone are no surface); give a mesh of triangles"
    raise MeshError(message)


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Return the byte order ("" for text), the elements, and where their rows begin."""
    head, found, _ = data[:MOST_HEADER_BYTES].partition(b"end_header")
    end = data.find(b"\n", len(head))
    if not head.startswith(b"ply") or not found or end < 0:
        message = "has no PLY header; give a PLY file"
        raise MeshError(message)
    order, elements = None, []
    # Lines of any other beginning are comments; some writers break these into several.
    for number, line in enumerate(head.decode("ascii", "replace").splitlines(), 1):
        match line.split():
            case ["format", name, *_] if name in FORMATS:
                order = FORMATS[name]
            case ["element", name, count] if count.isdecimal() and len(count) < 19:
                elements.append(_Element(name=name, count=int(count)))
            case ["property", "list", counted, kind, name] if elements and counted in TYPES and kind in TYPES:
                if TYPES[counted][0] == "f":
                    message = f"line {number} counts in {counted}; export the mesh again"
                    raise MeshError(message)
                elements[-1].properties.append(_Property(name=name, kind=TYPES[kind], count_kind=TYPES[counted]))
            case ["property", kind, name] if elements and kind in TYPES:
                elements[-1].properties.append(_Property(name=name, kind=TYPES[kind]))
            case ["element" | "property" | "format", *_]:
                message = f"line {number} of its header reads {shown(line)}; export the mesh again"
                raise MeshError(message)
    if order is None:
        message = "does not say its format in its header; export the mesh again"
        raise MeshError(message)
    return order, elements, end + 1


def _check_counts(elements: list[_Element], size: int, order: str) -> None:
    """Refuse a header that claims more rows than the file has bytes for, or than can be used."""
    for element in elements:
        row = sum(p.least_bytes if order else 2 for p in element.properties) or 1
        if element.count * row - (0 if order else 1) > size:
            message = f"claims {element.count:,} rows of {element.name} and has only {size:,} bytes; get the whole file"
            raise MeshError(message)
        check_count(element.count, MOST_VERTICES if element.name == "vertex" else MOST_FACES, f"rows of {element.name}")


class _Text:
    """The rows of a text file."""

    def __init__(self, data: bytes) -> None:
        self._lines = data.decode("ascii", "replace").splitlines()
        self._at = 0

    def _rows(self, element: _Element) -> list[list[str]]:
        rows: list[list[str]] = []
        while len(rows) < element.count:
            if self._at >= len(self._lines):
                message = f"ends after {len(rows):,} of {element.count:,} rows of {element.name}; get the whole file"
                raise MeshError(message)
            cells = self._lines[self._at].split()
            self._at += 1
            if cells:
                rows.append(cells)
        return rows

    def skip(self, element: _Element) -> None:
        self._rows(element)

    def numbers(self, element: _Element, wanted: list[int]) -> Float[np.ndarray, "row wanted"]:
        if any(p.count_kind for p in element.properties):
            message = f"has lists in its element {element.name}; export the mesh again"
            raise MeshError(message)
        rows = self._rows(element)
        if any(len(cells) != len(element.properties) for cells in rows):
            message = f"has a row of {element.name} that is not {len(element.properties)} numbers; export it again"
            raise MeshError(message)
        return np.array([[cells[i] for i in wanted] for cells in rows], dtype=np.float64).reshape(-1, len(wanted))

    def lists(self, element: _Element, wanted: int) -> tuple[Int[np.ndarray, " row"], Int[np.ndarray, " item"]]:
        size: list[int] = []
        items: list[str] = []
        for cells in self._rows(element):
            at, row = 0, None
            for place, given in enumerate(element.properties):
                count = int(cells[at]) if given.count_kind else 0
                if count < 0 or at + count >= len(cells):
                    message = f"has a row of {element.name} shorter than the list it begins; get the whole file"
                    raise MeshError(message)
                row = cells[at + 1 : at + 1 + count] if place == wanted else row
                at += 1 + count
            size.append(len(row or ()))
            items += row or ()
        return np.array(size, dtype=np.int64), np.array(items, dtype=np.int64)


class _Binary:
    """The rows of a binary file."""

    def __init__(self, data: bytes, start: int, order: str) -> None:
        self._data, self._at, self._order = data, start, order

    def _uniform(self, element: _Element) -> np.ndarray | None:
        """Return the rows if the lists of all are as long as those of the first; they are then behind us."""
        columns: list[tuple[Any, ...]] = []
        at = self._at
        for place, given in enumerate(element.properties):
            if given.count_kind:
                counted = np.dtype(self._order + given.count_kind)
                if at + counted.itemsize > len(self._data):
                    return None
                length = int(np.frombuffer(self._data, counted, 1, at)[0])
                if not 0 <= length <= len(self._data):
                    return None
                columns.append((f"count-{place}", counted))
                columns.append((f"{place}", np.dtype(self._order + given.kind), (length,)))
                at += counted.itemsize + length * np.dtype(given.kind).itemsize
            else:
                columns.append((f"{place}", np.dtype(self._order + given.kind)))
                at += np.dtype(given.kind).itemsize
        width = at - self._at
        if element.count == 0:
            return np.zeros(0, np.dtype(columns))
        if width * element.count + self._at > len(self._data):
            return None
        rows = np.frombuffer(self._data, np.dtype(columns), element.count, self._at)
        for name, *_ in columns:
            if name.startswith("count-") and np.any(rows[name] != rows[name][0]):
                return None
        self._at += width * element.count
        return rows

    def _row_by_row(self, element: _Element, wanted: int) -> tuple[list[int], list[bytes]]:
        size, items = [], []
        codes = [  # of each property, or of its count; the bytes of one of its items; whether it is a list
            (
                struct.Struct(self._order + np.dtype(p.count_kind or p.kind).char),
                np.dtype(p.kind).itemsize,
                p.count_kind,
            )
            for p in element.properties
        ]
        for number in range(element.count):
            for place, (code, width, counted) in enumerate(codes):
                if self._at + code.size > len(self._data):
                    message = f"ends in row {number + 1:,} of {element.count:,} of {element.name}; get the whole file"
                    raise MeshError(message)
                if counted is None:
                    self._at += width
                    continue
                (count,) = code.unpack_from(self._data, self._at)
                self._at += code.size
                if count < 0 or self._at + count * width > len(self._data):
                    message = f"ends in row {number + 1:,} of {element.count:,} of {element.name}; get the whole file"
                    raise MeshError(message)
                if place == wanted:
                    size.append(count)
                    items.append(self._data[self._at : self._at + count * width])
                self._at += count * width
        return size, items

    def skip(self, element: _Element) -> None:
        if self._uniform(element) is None:
            self._row_by_row(element, -1)

    def numbers(self, element: _Element, wanted: list[int]) -> Float[np.ndarray, "row wanted"]:
        rows = self._uniform(element)
        if rows is None or any(p.count_kind for p in element.properties):
            message = f"ends before its {element.count:,} rows of {element.name}; get the whole file"
            raise MeshError(message)
        return np.column_stack([rows[str(i)].astype(np.float64) for i in wanted])

    def lists(self, element: _Element, wanted: int) -> tuple[Int[np.ndarray, " row"], Int[np.ndarray, " item"]]:
        rows = self._uniform(element)
        if rows is not None:
            found = rows[str(wanted)].astype(np.int64)
            return np.full(len(found), found.shape[1]), found.ravel()
        size, items = self._row_by_row(element, wanted)
        kind = np.dtype(self._order + element.properties[wanted].kind)
        return np.array(size, dtype=np.int64), np.frombuffer(b"".join(items), kind).astype(np.int64)
