"""Segmentation of a stepped map into parts within which neighbours differ by less than a step.

Where a wall is crossed by a ramp of in-between heights, a cell or two wide, roof and ground would be one part. So parts
are first grown from cells in whose neighbourhood no step is (a morphological opening of the links between cells), and
take in what they touch. What no such part touches, narrower than three cells, joins the nearest.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_dilation, binary_erosion, distance_transform_edt, find_objects, label

# A part is raised if it is a step above this share of the adjacent cells.
BESIDE_CELLS, MAX_OF_RING = 2, 0.75
AROUND = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1))


def parts_of(height_m: Float[np.ndarray, "row column"], step_m: float, min_cells: int) -> Int[np.ndarray, "row column"]:
    """Return the number of the part of each cell, from zero without gaps.

    Parameters
    ----------
    height_m:
        Heights of the cells.
    step_m:
        Least difference between neighbours in different parts.
    min_cells:
        Smaller parts join the nearest.

    """
    along, across = (np.abs(np.diff(height_m, axis=axis)) <= step_m for axis in (1, 0))
    inner = _amid_links(along, across)
    part = label(inner)[0] - 1
    found = _with_touched(part, height_m, step_m)
    return _without_crumbs(found, min_cells)


def windows_of(part: Int[np.ndarray, "row column"]) -> list[tuple[slice, slice]]:
    """Return the rows and columns that contain each part, by their numbers."""
    return [(rows, columns) for rows, columns in find_objects(part + 1)]


def raised_cells(
    height_m: Float[np.ndarray, "row column"], part: Int[np.ndarray, "row column"], step_m: float
) -> Bool[np.ndarray, "row column"]:
    """Return the cells of raised parts: a step above most adjacent cells."""
    raised = np.zeros(part.shape, dtype=bool)
    for number, found in enumerate(windows_of(part)):
        window = tuple(slice(max(side.start - BESIDE_CELLS, 0), side.stop + BESIDE_CELLS) for side in found)
        cells, height = part[window] == number, height_m[window]
        ring = binary_dilation(cells, iterations=BESIDE_CELLS) & ~cells
        if ring.any() and np.mean(np.median(height[cells]) - height[ring] > step_m) > MAX_OF_RING:
            raised[window] |= cells
    return raised


def to_border_m(part: Int[np.ndarray, "row column"], spacing_m: float) -> Float[np.ndarray, "row column"]:
    """Return the distance of each cell from the border of its part, m; infinite if there is only one part."""
    border = np.zeros(part.shape, dtype=bool)
    along, across = part[:, 1:] != part[:, :-1], part[1:] != part[:-1]
    border[:, 1:] |= along
    border[:, :-1] |= along
    border[1:] |= across
    border[:-1] |= across
    distance: Float[np.ndarray, "row column"] = distance_transform_edt(~border) * spacing_m
    return distance if border.any() else np.full(part.shape, np.inf)


def _amid_links(
    along: Bool[np.ndarray, "row beside"], across: Bool[np.ndarray, "above column"]
) -> Bool[np.ndarray, "row column"]:
    """Return the cells around which, in three by three cells, all neighbours are linked."""
    right = np.pad(along, ((0, 0), (0, 1)), constant_values=True)
    below = np.pad(across, ((0, 1), (0, 0)), constant_values=True)
    # The links of a square of three: along rows between its first two columns, and across, likewise.
    of_row = binary_erosion(right, np.ones((3, 2)), origin=(0, 0), border_value=1)
    of_column = binary_erosion(below, np.ones((2, 3)), origin=(0, 0), border_value=1)
    return np.asarray(of_row & of_column)


def _with_touched(
    part: Int[np.ndarray, "row column"], height_m: Float[np.ndarray, "row column"], step_m: float
) -> Int[np.ndarray, "row column"]:
    """Return the parts with the cells that they touch: each joins the part of the nearest height, if within a step."""
    rows, columns = part.shape
    padded, heights = np.pad(part, 1, constant_values=-1), np.pad(height_m, 1, mode="edge")
    best, found = np.full(part.shape, step_m), part.copy()
    for down, right in AROUND:
        window = slice(1 + down, 1 + down + rows), slice(1 + right, 1 + right + columns)
        apart = np.abs(heights[window] - height_m)
        nearer = (part < 0) & (padded[window] >= 0) & (apart <= best)
        found[nearer], best[nearer] = padded[window][nearer], apart[nearer]
    return found


def _without_crumbs(part: Int[np.ndarray, "row column"], min_cells: int) -> Int[np.ndarray, "row column"]:
    """Return parts numbered from zero; cells of no part, or of one of fewer than `min_cells`, join the nearest."""
    crumb = (np.bincount(part.ravel() + 1)[part + 1] < min_cells) | (part < 0)
    if crumb.all():
        return np.zeros(part.shape, dtype=np.int64)
    row, column = distance_transform_edt(crumb, return_distances=False, return_indices=True)
    return np.asarray(np.unique(part[row, column], return_inverse=True)[1].reshape(part.shape))
