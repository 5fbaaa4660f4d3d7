"""Spatial cells in Morton order, and a bounding-box tree to find those inside a beam.

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
    columns = [surface, *place.T]
    low = [int(column.min()) for column in columns]
    size = [int(column.max()) - least + 1 for column, least in zip(columns, low, strict=True)]
    if float(np.prod(np.array(size, dtype=np.float64))) < MAX_BOXES:
        number = np.zeros(len(place), dtype=np.int64)
        for column, least, steps in zip(columns, low, size, strict=True):
            number = number * steps + (column.astype(np.int64) - least)
        return number, int(np.prod(size))
    _, cell = np.unique(np.column_stack([surface, place]), axis=0, return_inverse=True)
    return cell.ravel(), int(cell.max()) + 1


def grouped(cell: Int[np.ndarray, " piece"], count: int) -> tuple[Int[np.ndarray, " piece"], Int[np.ndarray, " edge"]]:
    """Return the order that groups pieces by cell, keeping theirs inside it, and where each occupied cell begins."""
    occupied = np.bincount(cell, minlength=count)
    return np.argsort(cell, kind="stable"), np.concatenate([[0], np.cumsum(occupied[occupied > 0])])


def regrouped(
    order: Int[np.ndarray, " piece"], edges: Int[np.ndarray, " edge"], along: Int[np.ndarray, " cell"]
) -> tuple[Int[np.ndarray, " piece"], Int[np.ndarray, " edge"]]:
    """Return groups in another order."""
    sizes = np.diff(edges)[along]
    out_edges = np.concatenate([[0], np.cumsum(sizes)])
    return order[np.repeat(edges[along] - out_edges[:-1], sizes) + np.arange(len(order))], out_edges


def curve(place: Int[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Return the number of each place along a Morton curve."""
    if len(place) == 0:
        return np.zeros(0, dtype=np.int64)
    value = (place - place.min(axis=0)).astype(np.int64)
    number = np.zeros(len(place), dtype=np.int64)
    for bit in range(int(value.max()).bit_length()):
        for axis in range(3):
            number |= ((value[:, axis] >> bit) & 1) << (3 * bit + axis)
    return number


# Boxes are taken as this much larger, for rounding.
SLACK_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class CellTree:
    """A binary tree of boxes over cells in an order in which neighbours are near each other.

    centre_m, half_m, radius_m: of each node its box's centre, half its sides and half its diagonal; the root is node 1,
        the children of node n are 2 n and 2 n + 1. Nodes without a cell have a negative radius.
    """

    centre_m: Float[np.ndarray, "node 3"]
    half_m: Float[np.ndarray, "node 3"]
    radius_m: Float[np.ndarray, " node"]

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
        (centre, half), radius = np.zeros((2, 2 * leaves, 3)), np.full(2 * leaves, -1.0)
        centre[held] = (low[held] + high[held]) / 2
        half[held] = (high[held] - low[held]) / 2 + SLACK_M
        radius[held] = np.linalg.norm(half[held], axis=1)
        return CellTree(centre_m=centre, half_m=half, radius_m=radius)

    def in_beams(
        self,
        apex_m: Float[np.ndarray, "beam 3"],
        R_world_antenna: Float[np.ndarray, "beam 3 3"],
        beam: FilledBeam,
    ) -> tuple[Int[np.ndarray, " beam_edge"], Int[np.ndarray, " pair"]]:
        """Return the cells that may reach into each beam: where each beam's begin, and the cells.

        apex_m, R_world_antenna: where the beams start, and the axes of their antennas.
        beam: what is searched of them.
        """
        apex_m, axes = np.ascontiguousarray(apex_m), np.ascontiguousarray(R_world_antenna)
        edges, stack = np.zeros(len(apex_m) + 1, dtype=np.int64), np.empty(128, dtype=np.int64)
        room = 64 * len(apex_m) + 64
        while True:
            cells = np.empty(room, dtype=np.int64)
            beams = apex_m, axes, beam.left, beam.up
            count = _search(self.centre_m, self.half_m, self.radius_m, *beams, stack, edges, cells)
            if count <= room:
                return edges, cells[:count]
            room = count


@compiled
@no_type_check
def _search(centre, half, radius, apex, axes, half_left, half_up, stack, edges, out):
    """Write the cells of each beam, as far as there is room, and where they end; return how many they are."""
    leaves = len(radius) // 2
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
            a, b, c = half[node, 0], half[node, 1], half[node, 2]
            left = abs(x * lx + y * ly + z * lz) - (a * abs(lx) + b * abs(ly) + c * abs(lz))
            up = abs(x * ux + y * uy + z * uz) - (a * abs(ux) + b * abs(uy) + c * abs(uz))
            left, up = max(left, 0.0) / half_left, max(up, 0.0) / half_up
            if left * left + up * up > far * far:
                continue
            if node < leaves:
                # The first child is visited first, so that cells come in their order.
                stack[depth], stack[depth + 1] = 2 * node + 1, 2 * node
                depth += 2
                continue
            if count < len(out):
                out[count] = node - leaves
            count += 1
        edges[beam + 1] = count
    return count
