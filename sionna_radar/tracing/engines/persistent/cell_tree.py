"""Cells of space: their pieces of surface, their order along a curve, and the tree searched for those in a beam.

Cells near each other are close along the curve. The tree bounds groups of cells, down to those that a beam reaches.
"""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.compiled import compiled
from sionna_radar.tracing.engines.persistent.density import FilledBeam

# Cells are counted one by one up to this many, whether they hold anything or not.
MAX_BOXES = 3e7


def numbered(
    place: Int[np.ndarray, "piece 3"], surface: Int[np.ndarray, " piece"]
) -> tuple[Int[np.ndarray, " piece"], int]:
    """Return the number of each piece's cell, the same for one place and surface, and how many numbers there are."""
    if len(place) == 0:
        return np.zeros(0, dtype=np.int64), 0
    low, size = _extent(place, surface)
    if float(np.prod(size.astype(np.float64))) < MAX_BOXES:
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


# Boxes are taken as this much larger, for rounding.
SLACK_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class CellTree:
    """A binary tree of spheres over cells in an order in which neighbours are near each other.

    centre_m, radius_m: of each node; the root is node 1, the children of node n are 2 n and 2 n + 1. Nodes without a
        cell have a negative radius.
    cells: how many there are.
    """

    centre_m: Float[np.ndarray, "node 3"]
    radius_m: Float[np.ndarray, " node"]
    cells: int

    @staticmethod
    def over(low_m: Float[np.ndarray, "cell 3"], high_m: Float[np.ndarray, "cell 3"]) -> "CellTree":
        """Return the tree over cells with given boxes."""
        leaves = 1 << max(0, int(np.ceil(np.log2(max(len(low_m), 1)))))
        low, high = np.full((2 * leaves, 3), np.inf), np.full((2 * leaves, 3), -np.inf)
        low[leaves : leaves + len(low_m)], high[leaves : leaves + len(low_m)] = low_m, high_m
        level = leaves
        while level > 1:
            for box, least in ((low, np.minimum), (high, np.maximum)):
                pairs = box[level : 2 * level].reshape(-1, 2, 3)
                box[level // 2 : level] = least(pairs[:, 0], pairs[:, 1])
            level //= 2
        held = np.all(high >= low, axis=1)
        centre, radius = np.zeros((2 * leaves, 3)), np.full(2 * leaves, -1.0)
        centre[held] = (low[held] + high[held]) / 2
        radius[held] = np.linalg.norm(high[held] - low[held], axis=1) / 2 + SLACK_M
        return CellTree(centre_m=centre, radius_m=radius, cells=len(low_m))

    def in_beams(
        self,
        apex_m: Float[np.ndarray, "beam 3"],
        R_world_antenna: Float[np.ndarray, "beam 3 3"],
        beam: FilledBeam,
    ) -> tuple[Int[np.ndarray, " beam_edge"], Int[np.ndarray, " pair"]]:
        """Return the cells that may reach into each beam: where each beam's begin, and the cells.

        Parameters
        ----------
        apex_m, R_world_antenna:
            Where the beams start, and the axes of their antennas.
        beam:
            What is searched of them.

        """
        found: tuple[np.ndarray, np.ndarray] = _search(
            self.centre_m, self.radius_m, apex_m, np.ascontiguousarray(R_world_antenna), beam.left, beam.up
        )
        return found


@compiled
@no_type_check
def _search(centre, radius, apex, axes, half_left, half_up):
    leaves = len(radius) // 2
    edges = np.zeros(len(apex) + 1, dtype=np.int64)
    out = np.empty(64 * len(apex) + 64, dtype=np.int64)
    stack = np.empty(128, dtype=np.int64)
    count = 0
    for beam in range(len(apex)):
        ax, ay, az = apex[beam, 0], apex[beam, 1], apex[beam, 2]
        fx, fy, fz = axes[beam, 0, 0], axes[beam, 1, 0], axes[beam, 2, 0]
        lx, ly, lz = axes[beam, 0, 1], axes[beam, 1, 1], axes[beam, 2, 1]
        ux, uy, uz = axes[beam, 0, 2], axes[beam, 1, 2], axes[beam, 2, 2]
        depth = 1
        stack[0] = 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            r = radius[node]
            if r < 0.0:
                continue
            x, y, z = centre[node, 0] - ax, centre[node, 1] - ay, centre[node, 2] - az
            if x * fx + y * fy + z * fz < -r:
                continue
            far = np.sqrt(x * x + y * y + z * z) + r
            left = max(abs(x * lx + y * ly + z * lz) - r, 0.0) / half_left
            up = max(abs(x * ux + y * uy + z * uz) - r, 0.0) / half_up
            if left * left + up * up > far * far:
                continue
            if node < leaves:
                # The first child is visited first, so that cells come in their order.
                stack[depth], stack[depth + 1] = 2 * node + 1, 2 * node
                depth += 2
                continue
            if count == len(out):
                grown = np.empty(2 * len(out), dtype=np.int64)
                for k in range(count):
                    grown[k] = out[k]
                out = grown
            out[count] = node - leaves
            count += 1
        edges[beam + 1] = count
    return edges, out[:count]
