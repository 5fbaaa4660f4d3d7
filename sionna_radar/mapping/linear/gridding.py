"""Gridding of points to a DEM: linear interpolation in Delaunay triangles, window by window, empty where unseen.

Left empty are cells farther than `max_gap_m` from every point, cells in triangles with a side longer than a few such
gaps (they close the bays of the outline, where nothing was seen), and cells in triangles across a radar shadow.
Such a triangle extends from an occluding edge to the ground behind it, parallel to the rays that passed the
edge: seen from the radar it is edge-on. Left empty too are cells in triangles between the foot and the top of a wall
(`walls`).

The grid is cut into windows that hold few points each, so that maps of long surveys take no more memory than short
ones. A window depends on the grid and the points alone, not on the process that works on it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.foundation.threads import chunks_of_bytes, in_threads
from sionna_radar.mapping.linear.triangulation import circles_hold_none, delaunay_triangles, fill_triangles
from sionna_radar.mapping.linear.walls import wall_triangles
from sionna_radar.mapping.options import LINEAR, LinearParameters
from sionna_radar.mapping.points import Points


@dataclass(frozen=True)
class Window:
    """A rectangular window of a grid."""

    grid: Grid
    rows: slice
    columns: slice

    @property
    def low_m(self) -> Float[np.ndarray, "2"]:
        """Centre of its first cell."""
        return np.array([self.grid.x_m[self.columns.start], self.grid.y_m[self.rows.start]])

    @property
    def high_m(self) -> Float[np.ndarray, "2"]:
        """Centre of its last cell."""
        return np.array([self.grid.x_m[self.columns.stop - 1], self.grid.y_m[self.rows.stop - 1]])

    def around(self, place_m: Float[np.ndarray, "n 2"], reach_m: float) -> Bool[np.ndarray, " n"]:
        """Return True where places are within `reach_m` of its cells along each axis."""
        return np.all((place_m >= self.low_m - reach_m) & (place_m <= self.high_m + reach_m), axis=1)


def windows_of(grid: Grid, place_m: Float[np.ndarray, "n 2"], most: int, least_m: float) -> list[Window]:
    """Return windows that together are the grid, each with about as many points as the others.

    grid: the grid.
    place_m: the points; those beyond the grid count in the windows at its edge.
    most: points of a window, unless it would become narrower than
    least_m: its least width and height.
    """
    cell = np.floor((place_m - [grid.west_m, grid.south_m]) / grid.spacing_m + 0.5).astype(np.int64)
    least = max(1, int(np.ceil(least_m / grid.spacing_m)))
    return list(_halves(Window(grid, slice(0, grid.rows), slice(0, grid.columns)), cell, most, least))


def _halves(window: Window, cell: np.ndarray, most: int, least: int) -> Iterator[Window]:
    """Yield the parts of a window, halved across its longer side as long as they hold too many points."""
    sides = window.columns, window.rows
    lengths = [side.stop - side.start for side in sides]
    axis = int(lengths[1] > lengths[0])
    if len(cell) <= most or lengths[axis] < 2 * least:
        yield window
        return
    side = sides[axis]
    middle = int(np.clip(np.median(cell[:, axis]), side.start + least, side.stop - least))
    below = cell[:, axis] < middle
    for half, inside in ((slice(side.start, middle), below), (slice(middle, side.stop), ~below)):
        columns, rows = (half, sides[1]) if axis == 0 else (sides[0], half)
        yield from _halves(Window(window.grid, rows, columns), cell[inside], most, least)


# Points that are triangulated at once, and the least width of their windows, relative to the longest side.
MAX_POINTS, MIN_SIDES = 25_000, 4.0


# Filled cells, by their numbers in the grid; the three points around each; and their weights.
Filled = tuple[Int[np.ndarray, " filled"], Int[np.ndarray, "filled 3"], Float[np.ndarray, "filled 3"]]


@dataclass(frozen=True)
class Interpolated:
    """A DEM of linear interpolation, and from which points each cell was made.

    cell: filled cells, by their numbers in the grid; corner: the three points around each; weight: their weights.
    """

    dem: Raster
    cell: Int[np.ndarray, " filled"]
    corner: Int[np.ndarray, "filled 3"]
    weight: Float[np.ndarray, "filled 3"]


def grid_points(
    points: Points,
    grid: Grid,
    max_gap_m: float,
    shadow_incidence_rad: float,
    options: LinearParameters = LINEAR,
) -> Interpolated:
    """Interpolate points to a grid.

    points: located echoes; of several at one horizontal position the highest counts.
    grid: grid of the DEM.
    max_gap_m: largest distance of a filled cell from a point.
    shadow_incidence_rad: a triangle wider than the gap and seen by the radar at a greater incidence is a shadow.
    options: of the method.
    """
    highest = _highest(points)
    unique = _UniquePoints(row=highest, point_m=points.position_m[highest], sigma_m=points.range_sigma_m[highest])
    longest_m = options.longest_side_gaps * max_gap_m
    windows = windows_of(grid, unique.place, MAX_POINTS, MIN_SIDES * longest_m)

    def part(number: int, _: int) -> Filled:
        near = windows[number].around(unique.place, longest_m) if len(windows) > 1 else np.ones(len(unique), dtype=bool)
        return _interpolated(
            unique, np.flatnonzero(near), points.origin_m, windows[number], max_gap_m, shadow_incidence_rad, options
        )

    pieces = list(in_threads(part, [(number, number + 1) for number in range(len(windows))]))
    height = np.full(grid.rows * grid.columns, np.nan)
    for cell, corner, weight in pieces:
        height[cell] = np.einsum("ck,ck->c", weight, unique.point_m[corner, 2])
    cell, corner, weight = (np.concatenate(each) for each in zip(*pieces, strict=True))
    dem = Raster(grid=grid, height_m=height.reshape(grid.shape))
    return Interpolated(dem, cell, highest[corner], weight)


@dataclass(frozen=True, kw_only=True)
class _UniquePoints(Columns):
    """Points of different horizontal positions: rows among all points, positions, errors of the ranges."""

    row: Int[np.ndarray, " n"]
    point_m: Float[np.ndarray, "n 3"]
    sigma_m: Float[np.ndarray, " n"]

    @property
    def place(self) -> Float[np.ndarray, "n 2"]:
        """Horizontal positions."""
        return self.point_m[:, :2]

    @cached_property
    def tree(self) -> KDTree:
        """The horizontal positions, by which the nearest are found."""
        return KDTree(self.place)


def _interpolated(
    unique: _UniquePoints,
    near: Int[np.ndarray, " near"],
    origin_m: Float[np.ndarray, "point 3"],
    window: Window,
    gap_m: float,
    incidence_rad: float,
    options: LinearParameters,
) -> Filled:
    """Return the filled cells of a window: their numbers in the grid, the three points around each, the weights.

    Only points near it are triangulated. All triangles that may fill a cell are among theirs, for these have no long
    sides; what is among them because farther points are not is sorted out.
    """
    nearby = unique if len(near) == len(unique) else unique.rows(near)
    simplices = delaunay_triangles(nearby.place)
    if not len(simplices):
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3))
    of_corners = unique.point_m.itemsize * 3 * 3
    some = (simplices[low:high] for low, high in chunks_of_bytes(len(simplices), of_corners))
    longest_m = options.longest_side_gaps * gap_m
    kept = np.concatenate(
        [_lit(nearby.point_m[each], origin_m[nearby.row[each]], gap_m, incidence_rad, longest_m) for each in some]
    )
    kept &= ~wall_triangles(nearby.point_m, nearby.sigma_m, simplices, gap_m, window.grid.spacing_m, options)
    if len(near) < len(unique):
        kept[kept] = circles_hold_none(nearby.place[simplices[kept]], unique.tree)
    inside = _triangle_of_cells(nearby.place, simplices, kept, window)
    row, column = np.nonzero(inside >= 0)
    triangle = inside[row, column]
    row, column = row + window.rows.start, column + window.columns.start
    cell_m = np.column_stack([window.grid.x_m[column], window.grid.y_m[row]])
    use = unique.tree.query(cell_m, distance_upper_bound=gap_m)[0] <= gap_m
    # In the order of the points: heights do not depend on what else was triangulated.
    corner = np.sort(simplices[triangle[use]], axis=1)
    weight = _barycentric(nearby.place[corner], cell_m[use])
    return (row * window.grid.columns + column)[use], near[corner], weight


def _triangle_of_cells(
    place: Float[np.ndarray, "n 2"],
    simplices: Int[np.ndarray, "triangle 3"],
    wanted: Bool[np.ndarray, " triangle"],
    window: Window,
) -> Int[np.ndarray, "row column"]:
    """Return the wanted triangle that each cell of a window lies in; -1 for none."""
    inside = np.full((window.rows.stop - window.rows.start, window.columns.stop - window.columns.start), -1)
    first = (float(window.low_m[0]), float(window.low_m[1]))
    fill_triangles(place, simplices, wanted, first, window.grid.spacing_m, inside)
    return inside


def _highest(points: Points) -> Int[np.ndarray, " n"]:
    """Return the highest of the points at each horizontal position."""
    order = np.lexsort((-points.position_m[:, 2], points.position_m[:, 1], points.position_m[:, 0]))
    place = points.position_m[order, :2]
    new = np.ones(len(place), dtype=bool)
    new[1:] = np.any(place[1:] != place[:-1], axis=1)
    return np.asarray(order[new])


def _lit(
    corner: Float[np.ndarray, "triangle 3 3"],
    origin: Float[np.ndarray, "triangle 3 3"],
    gap_m: float,
    incidence_rad: float,
    longest_m: float,
) -> Bool[np.ndarray, " triangle"]:
    """Return the triangles that are neither too wide nor in shadow, by their corners and where these were seen from."""
    side = np.roll(corner, -1, axis=1) - corner
    normal = np.cross(side[:, 0], side[:, 1])
    normal *= np.sign(normal[:, 2:])
    to_radar = origin.mean(axis=1) - corner.mean(axis=1)
    cos = np.einsum("ti,ti->t", normal, to_radar)
    cos /= np.maximum(np.linalg.norm(normal, axis=1) * np.linalg.norm(to_radar, axis=1), 1e-30)
    longest = np.linalg.norm(side, axis=2).max(axis=1)
    on_plan = np.linalg.norm(side[:, :, :2], axis=2).max(axis=1)
    shadow = (cos < np.cos(incidence_rad)) & (longest > gap_m)
    return ~shadow & (on_plan <= longest_m)


def _barycentric(
    corner: Float[np.ndarray, "cell 3 2"], cell: Float[np.ndarray, "cell 2"]
) -> Float[np.ndarray, "cell 3"]:
    """Return the weights of the corners of triangles at cells."""
    from_first = cell - corner[:, 0]
    b, c = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
    weight_b = (from_first[:, 0] * c[:, 1] - from_first[:, 1] * c[:, 0]) / area
    weight_c = (b[:, 0] * from_first[:, 1] - b[:, 1] * from_first[:, 0]) / area
    return np.column_stack([1 - weight_b - weight_c, weight_b, weight_c])
