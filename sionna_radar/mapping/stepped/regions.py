"""Regions of a stepped surface: connected cells between steps, their windows and borders."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import (
    binary_dilation,
    binary_erosion,
    distance_transform_edt,
    find_objects,
    label,
    maximum_filter,
    minimum_filter,
)

NEIGHBOURS = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1))
AROUND = np.ones((3, 3), dtype=bool)


def regions_of(height_m: Float[np.ndarray, "row column"], step_m: float) -> Int[np.ndarray, "row column"]:
    """Return connected regions without steps: the number of each cell's region, from zero without gaps.

    height_m: heights of the cells.
    step_m: least difference between neighbours in different regions.
    """
    along, across = (np.abs(np.diff(height_m, axis=axis)) <= step_m for axis in (1, 0))
    inner = _fully_linked(along, across)
    region = label(inner)[0] - 1
    extended = _extend_to_adjacent_cells(region, height_m, step_m)
    return _join_nearest(extended)


def region_windows(region: Int[np.ndarray, "row column"]) -> list[tuple[slice, slice]]:
    """Return the rows and columns that contain each region, by their numbers."""
    return [(rows, columns) for rows, columns in find_objects(region + 1)]


def distance_to_border_m(region: Int[np.ndarray, "row column"], spacing_m: float) -> Float[np.ndarray, "row column"]:
    """Return the distance of each cell from the border of its region, m; infinite if there is only one region."""
    border = np.zeros(region.shape, dtype=bool)
    along, across = region[:, 1:] != region[:, :-1], region[1:] != region[:-1]
    border[:, 1:] |= along
    border[:, :-1] |= along
    border[1:] |= across
    border[:-1] |= across
    distance: Float[np.ndarray, "row column"] = distance_transform_edt(~border) * spacing_m
    return distance if border.any() else np.full(region.shape, np.inf)


def _fully_linked(
    along: Bool[np.ndarray, "row beside"], across: Bool[np.ndarray, "above column"]
) -> Bool[np.ndarray, "row column"]:
    """Return the cells in whose 3 x 3 neighbourhood all neighbours are linked."""
    right = np.pad(along, ((0, 0), (0, 1)), constant_values=True)
    below = np.pad(across, ((0, 1), (0, 0)), constant_values=True)
    # The links of a square of three: along rows between its first two columns, and across, likewise.
    of_row = binary_erosion(right, np.ones((3, 2)), origin=(0, 0), border_value=1)
    of_column = binary_erosion(below, np.ones((2, 3)), origin=(0, 0), border_value=1)
    return np.asarray(of_row & of_column)


def _extend_to_adjacent_cells(
    region: Int[np.ndarray, "row column"], height_m: Float[np.ndarray, "row column"], step_m: float
) -> Int[np.ndarray, "row column"]:
    """Return regions extended to adjacent cells: each joins the region of the nearest height, if within a step."""
    rows, columns = region.shape
    padded, heights = np.pad(region, 1, constant_values=-1), np.pad(height_m, 1, mode="edge")
    best, extended = np.full(region.shape, step_m), region.copy()
    for down, right in NEIGHBOURS:
        window = slice(1 + down, 1 + down + rows), slice(1 + right, 1 + right + columns)
        difference_m = np.abs(heights[window] - height_m)
        nearer = (region < 0) & (padded[window] >= 0) & (difference_m <= best)
        extended[nearer], best[nearer] = padded[window][nearer], difference_m[nearer]
    return extended


def _join_nearest(region: Int[np.ndarray, "row column"]) -> Int[np.ndarray, "row column"]:
    """Return regions numbered from zero; cells of none join the nearest."""
    none = region < 0
    if none.all():
        return np.zeros(region.shape, dtype=np.int64)
    row, column = distance_transform_edt(none, return_distances=False, return_indices=True)
    return np.asarray(np.unique(region[row, column], return_inverse=True)[1].reshape(region.shape))


def border_cells(region: Int[np.ndarray, "row column"]) -> Bool[np.ndarray, "row column"]:
    """Return the cells with a neighbour in another region."""
    return np.asarray(maximum_filter(region, 3, mode="nearest") != minimum_filter(region, 3, mode="nearest"))


def unlike_pairs(region: Int[np.ndarray, "row column"]) -> int:
    """Return the number of pairs of neighbours in different regions, of eight neighbours each."""
    across = (region[1:], region[:-1]), (region[:, 1:], region[:, :-1])
    pairs = *across, (region[1:, 1:], region[:-1, :-1]), (region[1:, :-1], region[:-1, 1:])
    return sum(int(np.count_nonzero(one != other)) for one, other in pairs)


def window_around(
    row: Int[np.ndarray, " cell"], column: Int[np.ndarray, " cell"], shape: tuple[int, ...]
) -> tuple[slice, slice]:
    """Return the window of some cells and their neighbours."""
    return (
        slice(max(int(row.min()) - 1, 0), min(int(row.max()) + 2, shape[0])),
        slice(max(int(column.min()) - 1, 0), min(int(column.max()) + 2, shape[1])),
    )


def connected_parts(region: Int[np.ndarray, "row column"]) -> Iterator[Int[np.ndarray, " cell"]]:
    """Yield the cells of each connected part of a region, by running numbers, the smallest first; -1 is no region."""
    parts, count = [], region.shape[1]
    for number, window in enumerate(find_objects(region + 1)):
        if window is None:
            continue
        pieces, many = label(region[window] == number, AROUND)
        for piece in range(1, many + 1):
            row, column = np.nonzero(pieces == piece)
            parts.append((row + window[0].start) * count + column + window[1].start)
    yield from sorted(parts, key=len)


def adjacent_regions(
    region: Int[np.ndarray, "row column"], row: Int[np.ndarray, " cell"], column: Int[np.ndarray, " cell"]
) -> Int[np.ndarray, " region"]:
    """Return the other regions that are beside some cells of one."""
    window = window_around(row, column, region.shape)
    inside = np.zeros(region[window].shape, dtype=bool)
    inside[row - window[0].start, column - window[1].start] = True
    beside = np.unique(region[window][binary_dilation(inside, AROUND) & ~inside])
    return beside[beside != region[row[0], column[0]]]
