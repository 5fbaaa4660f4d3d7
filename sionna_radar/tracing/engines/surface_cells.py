"""Cells of space with the pieces of surface in them: the ground on which scatterers are drawn.

The triangles of each surface are divided until they are hardly larger than a cell, and every piece belongs to the cell
that holds its centre. A cell's expected number of scatterers is the integral of the density over its pieces.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from sionna_radar.scene.model import Surface
from sionna_radar.tracing.engines.density import DensityMap

# Scatterers that a cell should hold at the median density; the side follows, as a power of two.
PER_CELL = 24.0
FINEST_CELL_M, COARSEST_CELL_M = 2.0**-6, 2.0**6
# Longest side of a piece over that of a cell, and into how many parts a side is divided at most.
LONGEST_SIDE, MOST_PARTS = 2.0, 30_000
MOST_PIECES = 30_000_000


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


def cells_of(
    surfaces: Sequence[Surface],
    corner_m: Float[np.ndarray, "face 3 3"],
    first_face: Int[np.ndarray, " surface_edge"],
    density: DensityMap,
    region_m: Float[np.ndarray, "2 3"] | None,
) -> SurfaceCells:
    """Return the cells of some surfaces that scatterers are needed in.

    Parameters
    ----------
    surfaces:
        The surfaces.
    corner_m, first_face:
        Corners of the triangles of all of them, and where each surface's begin.
    density:
        Where how many scatterers are needed.
    region_m:
        Lowest and highest corner of the box of interest; pieces wholly outside get none. None: no limit.

    """
    box = np.array([[-np.inf] * 3, [np.inf] * 3]) if region_m is None else np.asarray(region_m, dtype=np.float64)
    side = cell_side_m(density.typical_per_m2)
    while True:
        found = _pieces(corner_m, box, density.columns, side, LONGEST_SIDE * side, MOST_PARTS, MOST_PIECES)
        if len(found[0]) < MOST_PIECES:
            break
        side *= 2
    face, parts, part, place, low, high, expected = found
    surface = np.searchsorted(first_face, face, side="right") - 1
    order = np.lexsort((_curve(place), surface))
    changed = np.any(np.diff(place[order], axis=0, prepend=np.iinfo(np.int64).min), axis=1)
    changed |= np.diff(surface[order], prepend=-1) != 0
    first = np.flatnonzero(changed)
    # The cells of all surfaces along one curve, so that neighbours are near each other in memory.
    cell_place = place[order[first]]
    along = np.argsort(_curve(cell_place), kind="stable")
    length = np.diff(first, append=len(order))[along]
    edges = np.concatenate([[0], np.cumsum(length)])
    order = order[np.arange(len(order)) - np.repeat(edges[:-1] - first[along], length)]
    start = edges[:-1]
    if len(start) == 0:
        low, high, total = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    else:
        low, high = np.minimum.reduceat(low[order], start), np.maximum.reduceat(high[order], start)
        total = np.add.reduceat(expected[order], start)
    return SurfaceCells(
        side_m=side,
        surface=surface[order[start]],
        place=place[order[start]],
        low_m=low,
        high_m=high,
        expected=total,
        first=edges,
        face=face[order],
        parts=parts[order],
        part=part[order],
    )


def _curve(place: Int[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Return the number of each place along a Morton curve."""
    if len(place) == 0:
        return np.zeros(0, dtype=np.int64)
    return _morton(place - place.min(axis=0))


@njit(cache=True, nogil=True)
@no_type_check
def _morton(place):
    out = np.empty(len(place), dtype=np.int64)
    for row in range(len(place)):
        number = np.int64(0)
        for axis in range(3):
            value = place[row, axis]
            for bit in range(21):
                number |= ((value >> bit) & 1) << (3 * bit + axis)
        out[row] = number
    return out


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
@no_type_check
def _area(corner):
    ux, uy, uz = (corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1], corner[1, 2] - corner[0, 2])
    vx, vy, vz = (corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1], corner[2, 2] - corner[0, 2])
    return 0.5 * np.sqrt((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2)


@njit(cache=True, nogil=True)
@no_type_check
def density_at(x, y, density):
    """Return the density of a `DensityMap` at a place of the plan."""
    west, south, step, per_m2 = density
    column = min(max(int(np.floor((x - west) / step)), 0), per_m2.shape[1] - 1)
    row = min(max(int(np.floor((y - south) / step)), 0), per_m2.shape[0] - 1)
    return per_m2[row, column]


@njit(cache=True, nogil=True)
@no_type_check
def _pieces(corner_m, box, density, side, longest, most_parts, most):
    """Return the pieces that bear scatterers; `most` of them mean that there are too many."""
    capacity = max(1024, len(corner_m) // 2)
    face = np.empty(capacity, dtype=np.int64)
    parts = np.empty(capacity, dtype=np.int64)
    part = np.empty(capacity, dtype=np.int64)
    place = np.empty((capacity, 3), dtype=np.int64)
    low, high = np.empty((capacity, 3)), np.empty((capacity, 3))
    expected = np.empty(capacity)
    count = 0
    piece = np.empty((3, 3))
    for f in range(len(corner_m)):
        corner = corner_m[f]
        outside = False
        longest2 = 0.0
        for axis in range(3):
            least = min(corner[0, axis], corner[1, axis], corner[2, axis])
            greatest = max(corner[0, axis], corner[1, axis], corner[2, axis])
            outside |= least > box[1, axis] or greatest < box[0, axis]
        if outside:
            continue
        for k in range(3):
            d = 0.0
            for axis in range(3):
                d += (corner[k, axis] - corner[(k + 1) % 3, axis]) ** 2
            longest2 = max(longest2, d)
        m = min(max(int(np.ceil(np.sqrt(longest2) / longest)), 1), most_parts)
        for k in range(m * m):
            piece_of(corner, m, k, piece)
            x = (piece[0, 0] + piece[1, 0] + piece[2, 0]) / 3
            y = (piece[0, 1] + piece[1, 1] + piece[2, 1]) / 3
            z = (piece[0, 2] + piece[1, 2] + piece[2, 2]) / 3
            n = density_at(x, y, density)
            if n <= 0.0:
                continue
            area = _area(piece)
            if area <= 0.0:
                continue
            if count == capacity:
                if capacity >= most:
                    return face, parts, part, place, low, high, expected
                grown = min(2 * capacity, most)
                face, parts, part = _grown(face, grown), _grown(parts, grown), _grown(part, grown)
                place, low, high = _grown_rows(place, grown), _grown_rows(low, grown), _grown_rows(high, grown)
                expected = _grown(expected, grown)
                capacity = grown
            face[count], parts[count], part[count] = f, m, k
            place[count, 0] = int(np.floor(x / side))
            place[count, 1] = int(np.floor(y / side))
            place[count, 2] = int(np.floor(z / side))
            for axis in range(3):
                low[count, axis] = min(piece[0, axis], piece[1, axis], piece[2, axis])
                high[count, axis] = max(piece[0, axis], piece[1, axis], piece[2, axis])
            expected[count] = n * area
            count += 1
    return face[:count], parts[:count], part[:count], place[:count], low[:count], high[:count], expected[:count]


@njit(cache=True, nogil=True)
@no_type_check
def _grown(array, size):
    out = np.empty(size, dtype=array.dtype)
    out[: len(array)] = array
    return out


@njit(cache=True, nogil=True)
@no_type_check
def _grown_rows(array, size):
    out = np.empty((size, 3), dtype=array.dtype)
    out[: len(array)] = array
    return out
