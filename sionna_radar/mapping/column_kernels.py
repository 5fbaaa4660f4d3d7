"""Rays against a map of columns with plane tops, as machine code; see `borders`."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.compiled import compiled

NOTHING = -1
# Rays approach the map in strides of so many cells.
STRIDE_CELLS = 4


class Columns(NamedTuple):
    """The map: height and slopes of each cell's top, and its part.

    ceiling: a height that no cell near reaches, not even after a change; highest: of all ceilings.
    """

    height: Float[np.ndarray, "row column"]
    slope_x: Float[np.ndarray, "row column"]
    slope_y: Float[np.ndarray, "row column"]
    part: Int[np.ndarray, "row column"]
    ceiling: Float[np.ndarray, "row column"]
    highest: float
    west: float
    south: float
    spacing: float


@compiled
@no_type_check
def cast(columns, x, y, z, dx, dy, dz, begin, farthest, row, column, height, slope_x, slope_y, part):
    """Return the range at which a ray meets the columns, and what it meets, if one of them were another (row >= 0)."""
    rows, count = columns.height.shape
    west, south, size = columns.west, columns.south, columns.spacing
    j = int(np.floor((x + begin * dx - west) / size))
    i = int(np.floor((y + begin * dy - south) / size))
    right, up = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    each_x = size / abs(dx) if dx != 0 else np.inf
    each_y = size / abs(dy) if dy != 0 else np.inf
    next_x = (west + (j + (dx > 0)) * size - x) / dx if dx != 0 else np.inf
    next_y = (south + (i + (dy > 0)) * size - y) / dy if dy != 0 else np.inf
    at = begin
    while at < farthest:
        leaves = min(next_x, next_y)
        if i < 0 or j < 0 or i >= rows or j >= count:
            if (i < 0 and up < 0) or (j < 0 and right < 0) or (i >= rows and up > 0) or (j >= count and right > 0):
                return np.inf, NOTHING
        else:
            if i == row and j == column:
                top, a, b, number = height, slope_x, slope_y, part
            else:
                top, a, b = columns.height[i, j], columns.slope_x[i, j], columns.slope_y[i, j]
                number = columns.part[i, j]
            top += a * (x + at * dx - west - (j + 0.5) * size) + b * (y + at * dy - south - (i + 0.5) * size)
            above = z + at * dz - top
            if above <= 0:
                return at, 2 * number + (1 if at > begin else 0)
            falls = a * dx + b * dy - dz
            if falls > 0 and at + above / falls <= leaves:
                return at + above / falls, 2 * number
        at = leaves
        if next_x <= next_y:
            j, next_x = j + right, next_x + each_x
        else:
            i, next_y = i + up, next_y + each_y
    return np.inf, NOTHING


@compiled
@no_type_check
def approach(columns, x, y, z, dx, dy, dz, farthest):
    """Return a range at which a ray is still above everything, near where it may meet the map."""
    rows, count = columns.height.shape
    stride = STRIDE_CELLS * columns.spacing / max(np.hypot(dx, dy), 1e-6)
    at = 0.0
    if dz < 0 and z > columns.highest:
        at = max(np.floor((z - columns.highest) / -dz / stride) - 1, 0.0) * stride
    while at + stride < farthest:
        then = at + stride
        i = min(max(int(np.floor((y + then * dy - columns.south) / columns.spacing)), 0), rows - 1)
        j = min(max(int(np.floor((x + then * dx - columns.west) / columns.spacing)), 0), count - 1)
        if z + then * dz <= columns.ceiling[i, j]:
            return at
        at = then
    return at


@compiled
@no_type_check
def candidate(columns, row, column, part):
    """Return height and slopes of the top of a cell if it belonged to a part of its neighbours, and their number."""
    height, a, b, count = 0.0, 0.0, 0.0, 0
    for down in range(-1, 2):
        for right in range(-1, 2):
            i, j = row + down, column + right
            if (down == 0 and right == 0) or i < 0 or j < 0 or i >= columns.part.shape[0] or j >= columns.part.shape[1]:
                continue
            if columns.part[i, j] == part:
                x, y = columns.slope_x[i, j], columns.slope_y[i, j]
                height += columns.height[i, j] - (x * right + y * down) * columns.spacing
                a, b, count = a + x, b + y, count + 1
    return (height / count, a / count, b / count, count) if count else (0.0, 0.0, 0.0, 0)
