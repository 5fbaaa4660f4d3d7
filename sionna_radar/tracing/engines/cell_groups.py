"""Which pieces of surface share a cell of space, and the order of cells along a curve: near ones together."""

from typing import no_type_check

import numpy as np
from jaxtyping import Int

from sionna_radar.foundation.compiled import compiled

# Cells are counted one by one up to this many, whether they hold anything or not.
MOST_BOXES = 3e7


def numbered(
    place: Int[np.ndarray, "piece 3"], surface: Int[np.ndarray, " piece"]
) -> tuple[Int[np.ndarray, " piece"], int]:
    """Return the number of each piece's cell, the same for one place and surface, and how many numbers there are."""
    if len(place) == 0:
        return np.zeros(0, dtype=np.int64), 0
    low, size = _extent(place, surface)
    if float(np.prod(size.astype(np.float64))) < MOST_BOXES:
        return _along_axes(place, surface, low, size), int(np.prod(size))
    _, cell = np.unique(np.column_stack([surface, place]), axis=0, return_inverse=True)
    return cell.ravel(), int(cell.max()) + 1


@compiled
@no_type_check
def _extent(place, surface):
    """Return the least surface and place of some pieces, and how many of each there are between these and the most."""
    low, high = np.empty(4, dtype=np.int64), np.empty(4, dtype=np.int64)
    for piece in range(len(place)):
        for axis in range(4):
            value = np.int64(surface[piece]) if axis == 0 else np.int64(place[piece, axis - 1])
            low[axis] = value if piece == 0 else min(low[axis], value)
            high[axis] = value if piece == 0 else max(high[axis], value)
    return low, high - low + 1


@compiled
@no_type_check
def _along_axes(place, surface, low, size):
    """Return the numbers of the pieces' cells in the box around all of them."""
    out = np.empty(len(place), dtype=np.int64)
    for piece in range(len(place)):
        number = surface[piece] - low[0]
        for axis in range(3):
            number = number * size[axis + 1] + (place[piece, axis] - low[axis + 1])
        out[piece] = number
    return out


@compiled
@no_type_check
def grouped(cell, count):
    """Return the order that groups pieces by cell, keeping theirs inside it, and where each occupied cell begins."""
    begin = np.zeros(count + 1, dtype=np.int64)
    for number in cell:
        begin[number + 1] += 1
    some = 0
    for number in range(count):
        some += begin[number + 1] > 0
        begin[number + 1] += begin[number]
    edges = np.empty(some + 1, dtype=np.int64)
    some = 0
    for number in range(count):
        if begin[number + 1] > begin[number]:
            edges[some] = begin[number]
            some += 1
    edges[some] = len(cell)
    order = np.empty(len(cell), dtype=np.int64)
    for piece in range(len(cell)):
        order[begin[cell[piece]]] = piece
        begin[cell[piece]] += 1
    return order, edges


@compiled
@no_type_check
def regrouped(order, edges, along):
    """Return groups in another order."""
    out, out_edges = np.empty_like(order), np.empty_like(edges)
    n = 0
    for number in range(len(along)):
        out_edges[number] = n
        for k in range(edges[along[number]], edges[along[number] + 1]):
            out[n] = order[k]
            n += 1
    out_edges[len(along)] = n
    return out, out_edges


def curve(place: Int[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Return the number of each place along a Morton curve."""
    if len(place) == 0:
        return np.zeros(0, dtype=np.int64)
    return _morton(place - place.min(axis=0))


@compiled
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
