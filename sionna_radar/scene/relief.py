"""Ray casting against gridded ground, by a pyramid of maximum heights instead of a search tree.

A pyramid of the greatest heights of blocks of cells tells where a ray from above can meet the ground: blocks that it
passes over are left behind at once (Tevs, Ihrke and Seidel 2008, "Maximum mipmaps for fast, accurate, and scalable
dynamic height field rendering"). In the cells that remain the ray is compared with the very triangles of
`model.mesh_of`. To build the pyramid takes a hundredth of the time of the tree that a mesh of as many triangles needs.
"""

from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int, Integer

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.threads import over_rows

# A ray goes at least this far into the next cell, in cells, so that rounding cannot hold it back.
NUDGE = 1e-9
# How much faster than the steepest ground a ray must climb to be sure of leaving it behind, for rounding.
STEEPER = 1.0 + 1e-6
# Steps along a ray for each row and column, more than any takes.
MAX_STEPS = 20


class Relief:
    """Ground of given heights, all of them known."""

    def __init__(self, raster: Raster) -> None:
        height, grid = np.ascontiguousarray(raster.height_m, dtype=np.float64), raster.grid
        pyramid, first, shapes = _pyramid(height)
        across, along = np.diff(height, axis=1) ** 2, np.diff(height, axis=0) ** 2
        steepest = np.maximum(across[:-1] + along[:, 1:], across[1:] + along[:, :-1]).max()
        self._steepest = float(np.sqrt(steepest) / grid.spacing_m)
        self._ground = (height, pyramid, first, shapes, float(grid.west_m), float(grid.south_m), float(grid.spacing_m))

    def first_hits(
        self, origin_m: Float[np.ndarray, "ray 3"], direction: Float[np.ndarray, "ray 3"]
    ) -> tuple[Float[np.ndarray, " ray"], Int[np.ndarray, " ray"], Float[np.ndarray, " ray"]]:
        """Return distance, triangle and cosine of incidence where rays along unit vectors first meet the ground.

        A miss has an infinite distance and triangle -1.
        """
        distance, face, cosine = (
            np.empty(len(origin_m)),
            np.empty(len(origin_m), dtype=np.int64),
            np.empty(len(origin_m)),
        )
        # Writable and in rows, whatever the caller has: machine code for one type of array.
        rays = tuple(np.require(each, np.float64, ["C", "W"]) for each in (origin_m, direction))
        over_rows(lambda low, high: _first_hits(low, high, self._ground, *rays, distance, face, cosine), len(origin_m))
        return distance, face, cosine

    def hides(
        self,
        origin_m: Float[np.ndarray, "origin 3"],
        row: Integer[np.ndarray, " ray"],
        point_m: Float[np.ndarray, "ray 3"],
        short: float,
    ) -> Bool[np.ndarray, " ray"]:
        """Return True where the ground is between points and the origins in given rows.

        The last share `short` of the way to the points is not looked at.
        """
        hidden = np.empty(len(row), dtype=np.bool_)
        ends = (np.asarray(origin_m, dtype=np.float64), row, point_m)
        ground = (self._ground, self._steepest)
        over_rows(lambda low, high: _hides(low, high, *ground, *ends, short, hidden), len(row))
        return hidden


def _pyramid(
    height: Float[np.ndarray, "row column"],
) -> tuple[Float[np.ndarray, " block"], Int[np.ndarray, " level"], Int[np.ndarray, "level 2"]]:
    """Return the greatest heights of all levels, where each level begins, and its rows and columns."""
    across = np.maximum(height[:, :-1], height[:, 1:])
    levels = [np.maximum(across[:-1], across[1:])]
    while max(levels[-1].shape) > 1:
        below = levels[-1]
        rows, columns = below.shape
        padded = np.pad(below, ((0, rows % 2), (0, columns % 2)), mode="edge")
        halved = np.maximum(padded[::2], padded[1::2])
        levels.append(np.maximum(halved[:, ::2], halved[:, 1::2]))
    first = np.cumsum([0, *(level.size for level in levels[:-1])])
    return np.concatenate([level.ravel() for level in levels]), first, np.array([level.shape for level in levels])


@compiled
@no_type_check
def _first_hits(low, high, ground, origin, direction, distance, face, cosine):
    height, _, first, _, west, south, step = ground
    columns = height.shape[1] - 1
    for ray in range(low, high):
        dx, dy, dz = direction[ray, 0], direction[ray, 1], direction[ray, 2]
        x, y = (origin[ray, 0] - west) / step, (origin[ray, 1] - south) / step
        start = len(first) - 1
        hit = _meet(ground, x, y, origin[ray, 2], dx / step, dy / step, dz, 0.0, np.inf, start)
        distance[ray], face[ray] = hit[0], hit[1]
        cosine[ray] = np.nan
        if hit[1] >= 0:
            cell = hit[1] // 2
            i, j = cell // columns, cell % columns
            a, b, c, d = height[i, j], height[i, j + 1], height[i + 1, j], height[i + 1, j + 1]
            east, north = (b - a, d - b) if hit[1] % 2 == 0 else (d - c, c - a)
            east, north = east / step, north / step
            slant = dz - east * dx - north * dy
            cosine[ray] = min(abs(slant) / np.sqrt(1.0 + east * east + north * north), 1.0)


@compiled
@no_type_check
def _hides(low, high, ground, steepest, origin, row, point, short, hidden):
    height, _, _, _, west, south, step = ground
    rows, columns = height.shape[0] - 1, height.shape[1] - 1
    for ray in range(low, high):
        # From the point upward: a ray soon leaves the ground behind.
        px, py, pz = np.float64(point[ray, 0]), np.float64(point[ray, 1]), np.float64(point[ray, 2])
        dx, dy, dz = origin[row[ray], 0] - px, origin[row[ray], 1] - py, origin[row[ray], 2] - pz
        x, y = (px - west) / step, (py - south) / step
        if dz > STEEPER * steepest * np.sqrt(dx * dx + dy * dy):
            # It climbs faster than any ground: once above, it stays above.
            u, v = x + short * dx / step, y + short * dy / step
            i, j = int(v), int(u)
            if u >= 0.0 and v >= 0.0 and i < rows and j < columns:
                half = 0 if u - j >= v - i else 1
                if _gap(height, i, j, half, u, v, pz + short * dz) > 0.0:
                    hidden[ray] = False
                    continue
        hit = _meet(ground, x, y, pz, dx / step, dy / step, dz, short, 1.0, np.int64(0))
        hidden[ray] = hit[1] >= 0 or hit[2] < 0


@compiled
@no_type_check
def _gap(height, i, j, half, x, y, z):
    """Return the height of a place above the plane of a triangle, within its cell."""
    u, v = min(max(x - j, 0.0), 1.0), min(max(y - i, 0.0), 1.0)
    a, d = height[i, j], height[i + 1, j + 1]
    if half == 0:
        b = height[i, j + 1]
        return z - (a + u * (b - a) + v * (d - b))
    c = height[i + 1, j]
    return z - (a + v * (c - a) + u * (d - c))


@compiled
@no_type_check
def _clipped(x, dx, last, near, far):
    """Return the part of a ray that lies between 0 and `last` along one axis."""
    if dx == 0.0:
        return (near, far) if 0.0 <= x <= last else (1.0, 0.0)
    one, other = -x / dx, (last - x) / dx
    return max(near, min(one, other)), min(far, max(one, other))


@compiled
@no_type_check
def _block(x, x0, per_cell, t, level, blocks):
    """Return the block along one axis that a ray is in, and where it leaves that block."""
    block = min(max(int(np.floor(x)) >> level, 0), blocks - 1)
    if per_cell == np.inf:
        return block, np.inf
    ahead = 1 if per_cell > 0.0 else 0
    leaves = (((block + ahead) << level) - x0) * per_cell
    if leaves <= t:
        # On the line between two blocks, along which the ray hardly moves.
        block = min(max(block + 2 * ahead - 1, 0), blocks - 1)
        leaves = (((block + ahead) << level) - x0) * per_cell
        if leaves <= t:
            return block, np.inf
    return block, leaves


@compiled
@no_type_check
def _meet(ground, x0, y0, z0, dx, dy, dz, near, far, level):
    """Return the ray parameter at the first crossing of the ground, the triangle (-1 for none), and the starting side.

    Places are in cells from the first corner, heights in metres. level: of the pyramid to begin with.
    """
    height, pyramid, first, shapes, _, _, _ = ground
    rows, columns = height.shape[0] - 1, height.shape[1] - 1
    near, far = _clipped(x0, dx, float(columns), near, far)
    near, far = _clipped(y0, dy, float(rows), near, far)
    if near > far:
        return np.inf, -1, 1
    top = pyramid[len(pyramid) - 1]
    x, y, z = x0 + near * dx, y0 + near * dy, z0 + near * dz
    i, j = min(max(int(y), 0), rows - 1), min(max(int(x), 0), columns - 1)
    half = 0 if x - j >= y - i else 1
    gap = _gap(height, i, j, half, x, y, z)
    side = -1 if gap < 0.0 else 1
    speed = np.sqrt(dx * dx + dy * dy)
    if speed < 1e-12 * (1.0 + abs(dz)):
        t = near if dz == 0.0 else near - gap / dz
        # Along a plumb line the ground is met at most once.
        return (t, 2 * (i * columns + j) + half, side) if near < t <= far and dz * side < 0.0 else (np.inf, -1, side)
    nudge = NUDGE / speed
    per_column, per_row = 1.0 / dx if dx != 0.0 else np.inf, 1.0 / dy if dy != 0.0 else np.inf
    if side < 0:
        level = 0
    t = near
    for _ in range(MAX_STEPS * (rows + columns) + 1000):
        if t >= far:
            break
        if side > 0 and dz >= 0.0 and z0 + t * dz > top:
            return np.inf, -1, side
        x, y = x0 + (t + nudge) * dx, y0 + (t + nudge) * dy
        i, down = _block(y, y0, per_row, t, level, shapes[level, 0])
        j, along = _block(x, x0, per_column, t, level, shapes[level, 1])
        end = min(min(along, down), far)
        if end <= t:
            end = min(t + nudge, far)
        if side > 0 and z0 + min(t * dz, end * dz) > pyramid[first[level] + i * shapes[level, 1] + j]:
            t = end
            level = min(level + 1, len(first) - 1)
            continue
        if level > 0:
            level -= 1
            continue
        # The diagonal divides the way through the cell in two, in each of which the gap is linear.
        x, y, xe, ye = x0 + t * dx, y0 + t * dy, x0 + end * dx, y0 + end * dy
        before, after = (x - j) - (y - i), (xe - j) - (ye - i)
        crosses = before * after < 0.0
        middle = t + (end - t) * before / (before - after) if crosses else end
        half = 0 if (before if crosses else before + after) >= 0.0 else 1
        begin = t
        for _ in range(2 if crosses else 1):
            one = side * _gap(height, i, j, half, x0 + begin * dx, y0 + begin * dy, z0 + begin * dz)
            other = side * _gap(height, i, j, half, x0 + middle * dx, y0 + middle * dy, z0 + middle * dz)
            if one < 0.0 and begin > near:
                return begin, 2 * (i * columns + j) + half, side
            if other < 0.0:
                fraction = one / (one - other) if one > 0.0 else 0.0
                return begin + fraction * (middle - begin), 2 * (i * columns + j) + half, side
            begin, middle, half = middle, end, 1 - half
        t = end
    return np.inf, -1, side
