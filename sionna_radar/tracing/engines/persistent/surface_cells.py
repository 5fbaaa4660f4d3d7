"""Spatial cells with their pieces of surface, in which scatterers are drawn.

The triangles of each surface are divided until they are hardly larger than a cell, and every piece belongs to the cell
that holds its centre. A cell's expected number of scatterers is the integral of the density over its pieces.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.threads import over_rows
from sionna_radar.scene.model import Surface
from sionna_radar.tracing.engines.persistent.cell_tree import curve, grouped, numbered, regrouped
from sionna_radar.tracing.engines.persistent.density import DensityMap

# Scatterers that a cell should hold at the median density; the side follows, as a power of two.
PER_CELL = 24.0
FINEST_CELL_M, COARSEST_CELL_M = 2.0**-6, 2.0**6
# Longest side of a piece over that of a cell, and into how many parts a side is divided at most.
LONGEST_SIDE, MAX_PARTS = 2.0, 30_000
MAX_PIECES = 30_000_000
# Type, and axes beyond the first, of the columns of pieces: triangle, parts, part, place and expected number.
PIECE: tuple[tuple[Any, ...], ...] = ((np.int32,), (np.int32,), (np.int32,), (np.int32, 3), (np.float64,))


@dataclass(frozen=True, kw_only=True)
class SurfaceCells:
    """Cells of space that hold pieces of surface, near ones together.

    side_m: of all cells.
    surface, place: of each cell: whose pieces it holds, and its position in units of its side.
    low_m, high_m: the box around its pieces.
    expected: number of scatterers.
    first: where its pieces begin; the last entry is the end of all.
    face, parts, part: of each piece: its triangle among those of all surfaces, into how many parts that one's sides
        are divided, and which part it is.
    """

    side_m: float
    surface: Int[np.ndarray, " cell"]
    place: Int[np.ndarray, "cell 3"]
    low_m: Float[np.ndarray, "cell 3"]
    high_m: Float[np.ndarray, "cell 3"]
    expected: Float[np.ndarray, " cell"]
    first: Int[np.ndarray, " edge"]
    face: Int[np.ndarray, " piece"]
    parts: Int[np.ndarray, " piece"]
    part: Int[np.ndarray, " piece"]

    def __len__(self) -> int:
        return len(self.surface)


def cell_side_m(per_m2: float) -> float:
    """Return the side of cells for a typical density: a power of two."""
    side = 2.0 ** np.round(np.log2(np.sqrt(PER_CELL / max(per_m2, 1e-9))))
    return float(np.clip(side, FINEST_CELL_M, COARSEST_CELL_M))


@dataclass(frozen=True, kw_only=True)
class Triangles:
    """The triangles of all surfaces of a scene.

    first: where those of each surface begin; the last entry is the end of all.
    corners: in 32 bits, whatever the surfaces have.
    """

    vertices_m: Float[np.ndarray, "vertex 3"]
    corners: Int[np.ndarray, "face 3"]
    first: Int[np.ndarray, " edge"]

    @staticmethod
    def of(surfaces: Sequence[Surface]) -> "Triangles":
        """Return the triangles of some surfaces."""
        below = np.cumsum([0, *(len(s.vertices_m) for s in surfaces)])
        corners = [np.asarray(s.faces + start, dtype=np.int32) for s, start in zip(surfaces, below, strict=False)]
        vertices = [s.vertices_m for s in surfaces]
        return Triangles(
            vertices_m=np.concatenate(vertices) if len(vertices) > 1 else vertices[0],
            corners=np.concatenate(corners) if len(corners) > 1 else corners[0],
            first=np.cumsum([0, *(len(s.faces) for s in surfaces)]),
        )


def cells_of(triangles: Triangles, density: DensityMap, region_m: Float[np.ndarray, "2 3"] | None) -> SurfaceCells:
    """Return the cells of some surfaces that scatterers are needed in.

    triangles: of the surfaces.
    density: where how many scatterers are needed.
    region_m: lowest and highest corner of the box of interest; pieces wholly outside get none. None: no limit.
    """
    box = np.array([[-np.inf] * 3, [np.inf] * 3]) if region_m is None else np.asarray(region_m, dtype=np.float64)
    side = cell_side_m(density.typical_per_m2)
    meshes = (triangles.vertices_m, triangles.corners)
    while True:
        pieces = _all_pieces(meshes, box, density, side)
        if len(pieces[0]) < MAX_PIECES:
            break
        side *= 2
    face, parts, part, place, expected = pieces
    several = len(triangles.first) > 2
    number = np.searchsorted(triangles.first, face, side="right") - 1 if several else np.zeros_like(face)
    surface = np.asarray(number, dtype=np.int32)
    cell, count = numbered(place, surface)
    order, edges = grouped(cell, count)
    first = order[edges[:-1]]
    # The cells of all surfaces along one curve, so that neighbours are near each other in memory.
    along = np.argsort(curve(place[first]), kind="stable")
    order, edges = regrouped(order, edges, along)
    first = order[edges[:-1]]
    low, high = np.full((len(first), 3), np.inf), np.full((len(first), 3), -np.inf)
    total = np.zeros(len(first))
    _boxes(order, edges, face, parts, part, expected, *meshes, *scratch(), low, high, total)
    return SurfaceCells(
        side_m=side,
        surface=surface[first],
        place=place[first].astype(np.int64),
        low_m=low,
        high_m=high,
        expected=total,
        first=edges,
        face=face[order],
        parts=parts[order],
        part=part[order],
    )


def _all_pieces(
    meshes: tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]],
    box: Float[np.ndarray, "2 3"],
    density: DensityMap,
    side_m: float,
) -> list[np.ndarray]:
    """Return triangle, parts, part, place and expected number of scatterers of every piece that bears some."""
    parts: dict[int, list[np.ndarray]] = {}
    sizes = (side_m, LONGEST_SIDE * side_m, MAX_PARTS)

    def search(low: int, high: int) -> None:
        """List the pieces of some faces, with more room until they fit."""
        room, at = min(max(1024, (high - low) // 2), MAX_PIECES), np.array([low, 0, 0])
        columns = [np.empty((room, *size), dtype=kind) for kind, *size in PIECE]
        while True:
            _pieces(at, high, *meshes, box, density.columns, *sizes, *scratch(), *columns)
            count = int(at[2])
            if at[0] == high or room == MAX_PIECES:
                break
            room = min(2 * room, MAX_PIECES)
            columns = [_grown(column, room) for column in columns]
        parts[low] = [column[:count] for column in columns]

    over_rows(search, len(meshes[1]))
    return [np.concatenate(column) for column in zip(*(parts[low] for low in sorted(parts)), strict=True)]


def scratch() -> np.ndarray:
    """Return room for the corners of a triangle and of a piece of it, which compiled code writes and reads."""
    return np.empty((2, 3, 3))


def _grown(column: np.ndarray, room: int) -> np.ndarray:
    """Return a larger array with the entries of a full one at its beginning."""
    out = np.empty((room, *column.shape[1:]), dtype=column.dtype)
    out[: len(column)] = column
    return out


@compiled
@no_type_check
def _boxes(order, edges, face, parts, part, expected, vertices, corners, corner, piece, low, high, total):
    """Extend the boxes of the cells around their pieces, and add up the pieces' expected numbers of scatterers."""
    for cell in range(len(edges) - 1):
        for k in range(edges[cell], edges[cell + 1]):
            cell_index = order[k]
            total[cell] += expected[cell_index]
            corners_of(np.int64(face[cell_index]), vertices, corners, corner)
            piece_of(corner, np.int64(parts[cell_index]), np.int64(part[cell_index]), piece)
            for number in range(3):
                for axis in range(3):
                    low[cell, axis] = min(low[cell, axis], piece[number, axis])
                    high[cell, axis] = max(high[cell, axis], piece[number, axis])


@compiled
@no_type_check
def corners_of(face, vertices, corners, out):
    """Write the corners of a triangle."""
    for number in range(3):
        for axis in range(3):
            out[number, axis] = vertices[corners[face, number], axis]


@compiled
@no_type_check
def piece_of(corner, parts, part, out):
    """Write the corners of one of the parts into which a triangle's sides are divided."""
    row = int(np.sqrt(part))
    while row * row > part:
        row -= 1
    while (row + 1) * (row + 1) <= part:
        row += 1
    column = part - row * row
    half = column // 2
    if column % 2 == 0:
        rows, columns = (row, row + 1, row + 1), (half, half, half + 1)
    else:
        rows, columns = (row, row + 1, row), (half, half + 1, half + 1)
    for number in range(3):
        b = (rows[number] - columns[number]) / parts
        c = columns[number] / parts
        for axis in range(3):
            out[number, axis] = (
                corner[0, axis] + b * (corner[1, axis] - corner[0, axis]) + c * (corner[2, axis] - corner[0, axis])
            )


@compiled
@no_type_check
def _area(corner):
    ux, uy, uz = (corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1], corner[1, 2] - corner[0, 2])
    vx, vy, vz = (corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1], corner[2, 2] - corner[0, 2])
    return 0.5 * np.sqrt((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2)


@compiled
@no_type_check
def density_at(x, y, density):
    """Return the density of a `DensityMap` at a place of the plan."""
    west, south, step, per_m2 = density
    column = min(max(int(np.floor((x - west) / step)), 0), per_m2.shape[1] - 1)
    row = min(max(int(np.floor((y - south) / step)), 0), per_m2.shape[0] - 1)
    return per_m2[row, column]


@compiled
@no_type_check
def _subdivisions(corner, longest):
    """Return the number of parts into which the sides of a triangle are divided, so that none is longer."""
    longest2 = 0.0
    for k in range(3):
        d = 0.0
        for axis in range(3):
            d += (corner[k, axis] - corner[(k + 1) % 3, axis]) ** 2
        longest2 = max(longest2, d)
    return max(int(np.ceil(np.sqrt(longest2) / longest)), 1)


@compiled
@no_type_check
def _row_outside(corner, row, parts, box):
    """Return True if a row of the parts of a triangle, all at one distance from its first corner, misses a box."""
    near, far = row / parts, (row + 1) / parts
    for axis in range(3):
        origin = corner[0, axis]
        b, c = corner[1, axis] - origin, corner[2, axis] - origin
        least, greatest = min(near * b, near * c, far * b, far * c), max(near * b, near * c, far * b, far * c)
        if origin + least > box[1, axis] or origin + greatest < box[0, axis]:
            return True
    return False


@compiled
@no_type_check
def _pieces(
    at, high, vertices, corners, box, density, side, longest, most_parts, corner, piece, face, parts, part, place,
    expected,
):  # fmt: skip
    """Write the pieces that bear scatterers, of the triangles before `high`, as long as there is room.

    at: where to begin, and then where the room ended: triangle (`high` at the end), part of it, and pieces written.
    """
    first_part, count = at[1], at[2]
    for f in range(at[0], high):
        corners_of(f, vertices, corners, corner)
        outside, across2 = False, 0.0
        for axis in range(3):
            least = min(corner[0, axis], corner[1, axis], corner[2, axis])
            greatest = max(corner[0, axis], corner[1, axis], corner[2, axis])
            outside |= least > box[1, axis] or greatest < box[0, axis]
            across2 += (greatest - least) ** 2
        if outside:
            continue
        # No side is longer than the box around the triangle.
        m = 1 if across2 <= longest * longest else min(_subdivisions(corner, longest), most_parts)
        for row in range(int(np.sqrt(first_part)), m):
            if m > 1 and _row_outside(corner, row, m, box):
                continue
            for k in range(max(first_part, row * row), (row + 1) * (row + 1)):
                n, area = expected_of(corner, m, k, density, piece)
                if n * area <= 0.0:
                    continue
                if count == len(face):
                    at[0], at[1], at[2] = f, k, count
                    return
                face[count], parts[count], part[count] = f, m, k
                for axis in range(3):
                    centre = (piece[0, axis] + piece[1, axis] + piece[2, axis]) / 3
                    place[count, axis] = int(np.floor(centre / side))
                expected[count] = n * area
                count += 1
        first_part = 0
    at[0], at[2] = high, count


@compiled
@no_type_check
def expected_of(corner, parts, part, density, piece):
    """Write the corners of a piece of a triangle, and return the density of scatterers on it, and its area."""
    if parts == 1:
        for number in range(3):
            for axis in range(3):
                piece[number, axis] = corner[number, axis]
    else:
        piece_of(corner, parts, part, piece)
    x = (piece[0, 0] + piece[1, 0] + piece[2, 0]) / 3
    y = (piece[0, 1] + piece[1, 1] + piece[2, 1]) / 3
    n = density_at(x, y, density)
    return n, _area(piece) if n > 0.0 else 0.0
