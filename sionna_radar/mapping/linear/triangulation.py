"""Delaunay triangulation of many points, piece by piece to bound memory.

A triangle is a Delaunay triangle if the circle through its corners holds no point. So points are triangulated in pieces
with those around them: a circle that lies within the box around a piece is empty for good. A point all of whose
triangles are so has all of its triangles. What is missing in the end are triangles between points that do not have all
of theirs, which are those at the outline: these few are triangulated together, and their circles compared with all
points.

A search for the triangle of each cell, such as SciPy's or matplotlib's, needs a structure that takes more time and
memory than the triangulation itself; the cells of a grid are found without one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, KDTree, QhullError

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.threads import in_threads

# Points of a piece, and the width of what is triangulated around it, relative to the mean distance of points.
PIECE_POINTS, AROUND = 12_500, 8.0
# The width is doubled while more points than this share lack some of their triangles.
MAX_MISSING = 0.1
# What is smaller than this share is rounding: a point so near to a circle is on it, a triangle so narrow is a line and
# holds no cell, a cell so near to a common side belongs to the first of its triangles.
ROUNDING = 1e-9

NONE = np.zeros((0, 3), dtype=np.int32)


def delaunay_triangles(place: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "triangle 3"]:
    """Return the corners of the Delaunay triangles of points; none of points that are too few or all on one line."""
    if len(place) <= 2 * PIECE_POINTS:
        return _triangles(place)[0]
    pieces = list(_pieces(place, np.arange(len(place))))
    around = AROUND
    while True:

        def of_piece(number: int, _: int, around: float = around) -> _Piece:
            return _piece(place, pieces[number], around)

        triangles = list(in_threads(of_piece, [(number, number + 1) for number in range(len(pieces))]))
        missing = np.concatenate([piece.missing for piece in triangles])
        if len(missing) <= MAX_MISSING * len(place):
            break
        around *= 2
        if around > np.sqrt(len(place)):
            return _triangles(place)[0]
    missing.sort()
    outer = missing[_triangles(place[missing])[0]].astype(np.int32)
    outer = outer[circles_hold_none(place[outer], KDTree(place))]
    # Pieces side by side both have what lies between them.
    between = np.unique(np.sort(np.concatenate([piece.between for piece in triangles]), axis=1), axis=0)
    return np.concatenate([*(piece.inside for piece in triangles), between, outer])


def circles_hold_none(corner: Float[np.ndarray, "triangle 3 2"], points: KDTree) -> Bool[np.ndarray, " triangle"]:
    """Return True where triangles are Delaunay triangles of points: no point lies in the circle through the corners."""
    centre, radius = _circles(corner)
    empty = np.isfinite(radius)
    empty[empty] = points.query(centre[empty])[0] >= radius[empty] * (1 - ROUNDING)
    return empty


def _triangles(place: Float[np.ndarray, "n 2"]) -> tuple[Int[np.ndarray, "triangle 3"], Bool[np.ndarray, " n"]]:
    """Return the triangles of points, and the points that these surround."""
    try:
        delaunay = Delaunay(place)
    except (QhullError, ValueError):  # too few points, or all on one line
        return NONE, np.zeros(len(place), dtype=bool)
    triangle, opposite = np.nonzero(delaunay.neighbors < 0)
    outline = delaunay.simplices[triangle[:, None], (opposite[:, None] + [1, 2]) % 3]
    surrounded = np.bincount(delaunay.simplices.ravel(), minlength=len(place)) > 0
    surrounded[outline] = False
    return delaunay.simplices, surrounded


def _pieces(place: Float[np.ndarray, "n 2"], member: Int[np.ndarray, " member"]) -> Iterator[Int[np.ndarray, " piece"]]:
    """Yield the points of each piece, halved across the longer side as long as they are too many."""
    if len(member) <= PIECE_POINTS:
        yield member
        return
    axis = int(np.argmax(np.ptp(place[member], axis=0)))
    half = len(member) // 2
    order = np.argpartition(place[member, axis], half)
    yield from _pieces(place, np.sort(member[order[:half]]))
    yield from _pieces(place, np.sort(member[order[half:]]))


@dataclass(frozen=True)
class _Piece:
    """The triangles at the points of a piece that have all of theirs, and the points that do not.

    inside, between: triangles with all corners in the piece, and those with some in others.
    """

    inside: Int[np.ndarray, "inside 3"]
    between: Int[np.ndarray, "between 3"]
    missing: Int[np.ndarray, " missing"]


def _piece(place: Float[np.ndarray, "n 2"], member: Int[np.ndarray, " member"], around: float) -> _Piece:
    """Return the triangles of a piece, found with the points around it."""
    low, high = place[member].min(axis=0), place[member].max(axis=0)
    wide_m = around * np.sqrt(np.prod(np.maximum(high - low, 1e-9)) / len(member))
    low, high = low - wide_m, high + wide_m
    near = np.flatnonzero(np.all((place >= low) & (place <= high), axis=1))
    if len(near) < 4:
        return _Piece(NONE, NONE, member)
    inner = np.isin(near, member, assume_unique=True)
    triangles, surrounded = _triangles(place[near])
    triangles = triangles[inner[triangles].any(axis=1)]
    centre, radius = _circles(place[near[triangles]])
    with np.errstate(invalid="ignore"):
        sure = np.all((centre - radius[:, None] > low) & (centre + radius[:, None] < high), axis=1)
    whole = inner & surrounded
    whole[triangles[~sure]] = False
    kept = triangles[whole[triangles].any(axis=1)]
    inside = inner[kept].all(axis=1)
    number = near.astype(np.int32)
    return _Piece(number[kept[inside]], number[kept[~inside]], near[inner & ~whole])


def _circles(
    corner: Float[np.ndarray, "triangle 3 2"],
) -> tuple[Float[np.ndarray, "triangle 2"], Float[np.ndarray, " triangle"]]:
    """Return centres and radii of the circles through corners; not finite where these are on one line."""
    b, c = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    twice = 2 * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    bb, cc = np.sum(b**2, axis=1), np.sum(c**2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = (c[:, 1] * bb - b[:, 1] * cc) / twice, (b[:, 0] * cc - c[:, 0] * bb) / twice
    return corner[:, 0] + np.column_stack([x, y]), np.hypot(x, y)


@compiled
@no_type_check
def fill_triangles(place, corner, wanted, first, spacing, inside):
    """Write for each cell the first of the wanted triangles that it lies in; others are left as they are.

    place: x and y of each point; corner: the three points of each triangle; wanted: which triangles count.
    first: x and y of the centre of the first cell; spacing: of the cells; inside: numbers of triangles, by row (y) and
        column (x), -1 for none.
    """
    rows, columns = inside.shape
    west, south = first
    for triangle in range(len(corner)):
        if not wanted[triangle]:
            continue
        a, b, c = corner[triangle]
        # In cells, from the first corner.
        bx, by = (place[b, 0] - place[a, 0]) / spacing, (place[b, 1] - place[a, 1]) / spacing
        cx, cy = (place[c, 0] - place[a, 0]) / spacing, (place[c, 1] - place[a, 1]) / spacing
        area = bx * cy - by * cx
        side = (cx - bx) ** 2 + (cy - by) ** 2
        longest = max(bx**2 + by**2, cx**2 + cy**2, side)
        if abs(area) <= ROUNDING * longest:
            continue
        ax, ay = (place[a, 0] - west) / spacing, (place[a, 1] - south) / spacing
        low_column = max(int(-(-(ax + min(0.0, bx, cx) - ROUNDING) // 1.0)), 0)
        high_column = min(int((ax + max(0.0, bx, cx) + ROUNDING) // 1.0), columns - 1)
        low_row = max(int(-(-(ay + min(0.0, by, cy) - ROUNDING) // 1.0)), 0)
        high_row = min(int((ay + max(0.0, by, cy) + ROUNDING) // 1.0), rows - 1)
        for row in range(low_row, high_row + 1):
            y = row - ay
            for column in range(low_column, high_column + 1):
                x = column - ax
                of_b = (x * cy - y * cx) / area
                of_c = (bx * y - by * x) / area
                if of_b < -ROUNDING or of_c < -ROUNDING or of_b + of_c > 1.0 + ROUNDING:
                    continue
                if inside[row, column] < 0:
                    inside[row, column] = triangle
