"""Detection of wall triangles, between the foot and the top of a wall, in a triangulation.

Two signs, each enough. A triangle is steep, and ground as steep would go on being steep at one of its ends. Or one of
its sides joins two levels: it is steeper than the ground beyond both of its ends, by more than half of 45 deg's slope.
Between lines far apart the second finds walls that make no steep triangle. A bank with an echo on it goes on at that
end of the side, and a crease at one of them; what only a bank narrower than the way between two echoes would explain,
nothing that was seen tells from a wall. Along sides longer than the diagonal of the widest gap between beams, echoes
are missing: there any jump is a shadow's.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.threads import chunks_of_bytes
from sionna_radar.mapping.options import LINEAR, LinearParameters

# The slopes of triangles this narrow, relative to their longest side, are those of noise.
NARROW = 0.1
# Triangles with less area, in plan view, have no slope.
NO_AREA_M2 = 1e-9


def wall_triangles(
    point_m: Float[np.ndarray, "n 3"],
    sigma_m: Float[np.ndarray, " n"],
    corner: Int[np.ndarray, "triangle 3"],
    gap_m: float,
    least_m: float,
    options: LinearParameters = LINEAR,
) -> Bool[np.ndarray, " triangle"]:
    """Return the triangles between the foot and the top of a wall.

    point_m: points in the world frame.
    sigma_m: standard deviations of their ranges.
    corner: the three points of each triangle.
    gap_m: widest gap between neighbouring beams on the ground.
    least_m: least height of a wall.
    options: of the method.
    """
    if not len(corner):
        return np.zeros(0, dtype=bool)
    bounds = chunks_of_bytes(len(corner), point_m.itemsize * 3 * 3)
    slope, broad = np.empty(len(corner)), np.empty(len(corner), dtype=bool)
    for low, high in bounds:
        gradient, broad[low:high] = _slopes(point_m, corner[low:high])
        slope[low:high] = np.hypot(*gradient.T)
    steep = _steep(point_m, sigma_m, corner, slope, least_m, options)
    side = _Sides.concatenate(
        [_high_sides(point_m, sigma_m, corner, slice(low, high), gap_m, least_m, options) for low, high in bounds]
    )
    if not len(side):
        return steep
    jump = slope > options.wall_slope
    neighbours = _touching(corner, np.concatenate([side.start, side.end]), len(point_m))
    beside_corner, gradient = corner[neighbours], _slopes(point_m, corner[neighbours])[0]
    for _ in range(options.wall_rounds):
        ground = (broad & ~jump)[neighbours]
        beyond = _slopes_beyond(point_m, beside_corner[ground], gradient[ground], side.start, side.end)
        # By how much the side falls or rises more than it would at either slope; false for two unknown ones.
        more_m = (side.rise_m - beyond * side.way_m) * np.sign(side.rise_m)
        jump = np.zeros(len(corner), dtype=bool)
        jump[side.triangle[np.fmin(*more_m) > side.most_m]] = True
    return steep | jump


@dataclass(frozen=True, kw_only=True)
class _Sides(Columns):
    """Sides of triangles: which triangle, its corners, from one to the other on the ground and in height, the most."""

    triangle: Int[np.ndarray, " side"]
    start: Int[np.ndarray, " side"]
    end: Int[np.ndarray, " side"]
    way_m: Float[np.ndarray, " side"]
    rise_m: Float[np.ndarray, " side"]
    most_m: Float[np.ndarray, " side"]


def _high_sides(
    point_m: Float[np.ndarray, "n 3"],
    sigma_m: Float[np.ndarray, " n"],
    corner: Int[np.ndarray, "triangle 3"],
    chunk: slice,
    gap_m: float,
    least_m: float,
    options: LinearParameters,
) -> _Sides:
    """Return the sides of some triangles that rise by more than a bank, noise or the least wall."""
    start, end = corner[chunk].ravel(), np.roll(corner[chunk], -1, axis=1).ravel()
    side = point_m[end] - point_m[start]
    way_m = np.linalg.norm(side[:, :2], axis=1)
    least = options.wall_sigmas * np.hypot(sigma_m[start], sigma_m[end])
    bank_m = np.where(way_m > options.wall_diagonal * gap_m, 0.0, options.wall_slope / 2 * way_m)
    most_m = np.maximum(bank_m, np.maximum(least, least_m))
    high = np.flatnonzero((np.abs(side[:, 2]) > most_m) & (way_m > 0))
    return _Sides(
        triangle=chunk.start + high // 3,
        start=start[high],
        end=end[high],
        way_m=way_m[high],
        rise_m=side[high, 2],
        most_m=most_m[high],
    )


def _steep(
    point_m: Float[np.ndarray, "n 3"],
    sigma_m: Float[np.ndarray, " n"],
    corner: Int[np.ndarray, "triangle 3"],
    slope: Float[np.ndarray, " triangle"],
    least_m: float,
    options: LinearParameters,
) -> Bool[np.ndarray, " triangle"]:
    """Return the triangles steeper than 45 deg, and twice as steep as the ground at two of their corners.

    The ground's slope is the median over the other triangles there; and the height is none of the ranges' uncertainty.
    """
    steep = np.flatnonzero(slope > options.wall_slope)
    height = np.ptp(point_m[corner[steep], 2], axis=1)
    steep = steep[(height > least_m) & (height > options.wall_sigmas * sigma_m[corner[steep]].max(axis=1))]
    steep_walls = np.zeros(len(corner), dtype=bool)
    if len(steep) in {0, len(corner)}:
        return steep_walls
    # The slope of the ground is wanted at their corners, and at the neighbours of these.
    around = _touching(corner, corner[steep], len(point_m))
    level = np.setdiff1d(_touching(corner, corner[around], len(point_m)), steep, assume_unique=True)
    ground = np.nan_to_num(_medians(corner[level].ravel(), np.repeat(slope[level], 3), len(point_m)), nan=np.inf)
    # A point amid steep triangles alone may be an echo of the wall: the ground is that of its neighbours, if they have
    # any. On a hillside they have none either.
    adjacent = np.full(len(point_m), np.inf)
    np.minimum.at(adjacent, corner[around].ravel(), np.repeat(ground[corner[around]].min(axis=1), 3))
    ground = np.where(np.isinf(ground), adjacent, ground)
    steep_walls[steep] = slope[steep] > options.wall_contrast * np.median(ground[corner[steep]], axis=1)
    return steep_walls


def _touching(
    corner: Int[np.ndarray, "triangle 3"], points: Int[np.ndarray, "..."], count: int
) -> Int[np.ndarray, " touching"]:
    """Return the triangles with a corner among some of so many points, in order."""
    wanted = np.zeros(count, dtype=bool)
    wanted[points] = True
    return np.flatnonzero(wanted[corner].any(axis=1))


def _slopes_beyond(
    point_m: Float[np.ndarray, "n 3"],
    corner: Int[np.ndarray, "triangle 3"],
    gradient: Float[np.ndarray, "triangle 2"],
    start: Int[np.ndarray, " side"],
    end: Int[np.ndarray, " side"],
) -> Float[np.ndarray, "2 side"]:
    """Return the slopes along each side before its start and beyond its end; NaN where they are unknown.

    Of several triangles at an end, on the far side of it, the median counts.
    """
    along = point_m[end, :2] - point_m[start, :2]
    along /= np.linalg.norm(along, axis=1)[:, None]
    order = np.argsort(corner.ravel(), kind="stable")
    first = np.searchsorted(corner.ravel()[order], np.arange(len(point_m) + 1))
    middle = point_m[corner, :2].mean(axis=1)
    slopes = []
    for point, away in ((start, -along), (end, along)):
        count = first[point + 1] - first[point]
        side = np.repeat(np.arange(len(point)), count)
        within = np.arange(len(side)) - np.repeat(np.cumsum(count) - count, count)
        triangle = order[first[point][side] + within] // 3
        beyond = np.einsum("ij,ij->i", middle[triangle] - point_m[point[side], :2], away[side]) > 0
        side, triangle = side[beyond], triangle[beyond]
        slopes.append(_medians(side, np.einsum("ij,ij->i", gradient[triangle], along[side]), len(point)))
    return np.stack(slopes)


def _medians(
    of: Int[np.ndarray, " value"], value: Float[np.ndarray, " value"], count: int
) -> Float[np.ndarray, " count"]:
    """Return the median of the values of each owner, the upper of two; NaN without any."""
    if not len(value):
        return np.full(count, np.nan)
    ordered = value[np.lexsort((value, of))]
    many = np.bincount(of, minlength=count)
    middle = np.concatenate([[0], np.cumsum(many)[:-1]]) + many // 2
    return np.where(many > 0, ordered[np.minimum(middle, len(ordered) - 1)], np.nan)


def _slopes(
    point_m: Float[np.ndarray, "n 3"], corner: Int[np.ndarray, "triangle 3"]
) -> tuple[Float[np.ndarray, "triangle 2"], Bool[np.ndarray, " triangle"]]:
    """Return the slopes of triangles toward east and north, and which are broad enough in plan view to have one."""
    at = point_m[corner]
    side = np.roll(at, -1, axis=1) - at
    longest_m2 = np.max(side[..., 0] ** 2 + side[..., 1] ** 2, axis=1)
    normal = np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])
    normal *= np.where(normal[:, 2:] < 0, -1.0, 1.0)
    return -normal[:, :2] / np.maximum(normal[:, 2:], NO_AREA_M2), normal[:, 2] > NARROW * longest_m2
