"""Fisher information of all echoes on the heights of grid cells, as a linear operator.

The factor F of a pulse acts on the heights under its nodes, and those are bilinear in the cells around. Where a
footprint covers fewer cells than there are nodes, F is brought onto the cells once, which is then less work each time
that the curvature is applied.
"""

from collections.abc import Callable
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Float32

from sionna_radar.elevation.heightfield import corner_of, height_at
from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import equal_chunks, in_threads
from sionna_radar.inference.echo.likelihood import Linearised

Information = Callable[[Float[np.ndarray, " cell"]], Float[np.ndarray, " cell"]]


def curvature_on_cells(linear: Linearised, grid: Grid) -> Information:
    """Return the operator W^T F^T F W on the heights of the cells, W taking them to the nodes of the beams."""
    place = linear.place_m
    on = grid.west_m, grid.south_m, grid.spacing_m, grid.rows, grid.columns
    cell, local = np.empty(place.size * 2, dtype=np.int32), np.empty((*place.shape[:2], 4), dtype=np.int32)
    count = touch(place, *on, np.full((grid.rows * grid.columns, 2), -1), cell, local)
    start = np.concatenate([[0], np.cumsum((linear.last - linear.first) * count[1:])])
    if start[-1] > int((linear.last - linear.first).sum()) * place.shape[1]:
        return _by_nodes(linear, grid)
    on_cells, begin = np.empty(start[-1], dtype=np.float32), np.cumsum(count)
    onto = linear.factor, linear.first, linear.last, place, *on, local, count[1:], start, on_cells
    list(in_threads(lambda low, high: onto_cells(*onto, low, high), equal_chunks(len(place))))
    cell = cell[: begin[-1]].copy()

    def some(height_m: Float32[np.ndarray, " cell"], result: Float[np.ndarray, " cell"], low: int, high: int) -> None:
        curve_cells(on_cells, start, cell, begin, height_m, result, low, high)

    return _summed(some, len(place))


def _by_nodes(linear: Linearised, grid: Grid) -> Information:

    factor = linear.factor, linear.first, linear.last, linear.place_m, grid.west_m, grid.south_m, grid.spacing_m

    def some(height_m: Float32[np.ndarray, " cell"], result: Float[np.ndarray, " cell"], low: int, high: int) -> None:
        curve_nodes(*factor, height_m.reshape(grid.shape), result.reshape(grid.shape), low, high)

    return _summed(some, len(linear.place_m))


def _summed(
    some: Callable[[Float32[np.ndarray, " cell"], Float[np.ndarray, " cell"], int, int], None], pulses: int
) -> Information:
    """Return the sum over all pulses of what some of them add."""

    def informed(height_m: Float[np.ndarray, " cell"]) -> Float[np.ndarray, " cell"]:
        """Return the product of all pulses' information with heights, summed in the order of the threads."""
        single = height_m.astype(np.float32, copy=False)

        def part(low: int, high: int) -> Float[np.ndarray, " cell"]:
            result = np.zeros(height_m.size, dtype=height_m.dtype)
            some(single, result, low, high)
            return result

        first, *others = in_threads(part, equal_chunks(pulses))
        for other in others:
            first += other
        return first

    return informed


@compiled
@no_type_check
def curve_nodes(factor, first, last, place, west, south, spacing, height, result, low, high):
    """Add the curvature of the pulses from `low` to `high`, applied to the heights of all cells, to `result`."""
    rows, columns = height.shape
    nodes = place.shape[1]
    under, back = np.empty(nodes, dtype=np.float32), np.empty(nodes, dtype=np.float32)
    for pulse in range(low, high):
        if first[pulse] == last[pulse]:
            continue
        for node in range(nodes):
            x, y = place[pulse, node, 0], place[pulse, node, 1]
            under[node] = height_at(height, west, south, spacing, x, y)
        own = factor[first[pulse] : last[pulse]]
        np.dot(np.dot(own, under), own, back)
        for node in range(nodes):
            x, y = place[pulse, node, 0], place[pulse, node, 1]
            i, j, b, a = corner_of(x, y, west, south, spacing, rows, columns)
            result[i, j] += back[node] * (1 - a) * (1 - b)
            result[i, j + 1] += back[node] * a * (1 - b)
            result[i + 1, j] += back[node] * (1 - a) * b
            result[i + 1, j + 1] += back[node] * a * b


@compiled
@no_type_check
def touch(place, west, south, spacing, rows, columns, seen_by, cell, local):
    """Write the cells under the nodes of each pulse, numbered along the rows of the grid, without repeating any.

    seen_by: two values for each cell of the grid, the first of them -1 at the beginning.
    cell: room for four cells a node; local: for each node, which of the pulse's cells are the four around it.
    Returns the number of cells of each pulse, behind a zero.
    """
    count = np.zeros(len(place) + 1, dtype=np.int64)
    used = 0
    for pulse in range(len(place)):
        begin = used
        for node in range(place.shape[1]):
            i, j, _, _ = corner_of(place[pulse, node, 0], place[pulse, node, 1], west, south, spacing, rows, columns)
            for k in range(4):
                at = (i + k // 2) * columns + j + k % 2
                if seen_by[at, 0] != pulse:
                    seen_by[at, 0], seen_by[at, 1] = pulse, used - begin
                    cell[used] = at
                    used += 1
                local[pulse, node, k] = seen_by[at, 1]
        count[pulse + 1] = used - begin
    return count


@compiled
@no_type_check
def onto_cells(
    factor, first, last, place, west, south, spacing, rows, columns, local, count, start, on_cells, low, high
):
    """Write F of the pulses from `low` to `high` as it acts on their cells, row by row, from `start` on."""
    weight = np.empty((place.shape[1], 4))
    for pulse in range(low, high):
        cells = count[pulse]
        for node in range(place.shape[1]):
            _, _, b, a = corner_of(place[pulse, node, 0], place[pulse, node, 1], west, south, spacing, rows, columns)
            weight[node, 0], weight[node, 1] = (1 - a) * (1 - b), a * (1 - b)
            weight[node, 2], weight[node, 3] = (1 - a) * b, a * b
        for row in range(last[pulse] - first[pulse]):
            at = start[pulse] + row * cells
            for k in range(at, at + cells):
                on_cells[k] = 0.0
            for node in range(place.shape[1]):
                value = factor[first[pulse] + row, node]
                for c in range(4):
                    on_cells[at + local[pulse, node, c]] += value * weight[node, c]


@compiled
@no_type_check
def curve_cells(on_cells, start, cell, begin, height, result, low, high):
    """Add the curvature of the pulses from `low` to `high`, applied to the heights of all cells, to `result`."""
    most = 1
    for pulse in range(low, high):
        cells = begin[pulse + 1] - begin[pulse]
        most = max(most, cells, (start[pulse + 1] - start[pulse]) // max(cells, 1))
    memory = np.empty(3 * most, dtype=np.float32)
    for pulse in range(low, high):
        cells, size = begin[pulse + 1] - begin[pulse], start[pulse + 1] - start[pulse]
        if size == 0:
            continue
        block = on_cells[start[pulse] : start[pulse + 1]].reshape((size // cells, cells))
        under, back, along = memory[:cells], memory[most : most + cells], memory[2 * most : 2 * most + size // cells]
        for k in range(cells):
            under[k] = height[cell[begin[pulse] + k]]
        np.dot(block, under, along)
        np.dot(along, block, back)
        for k in range(cells):
            result[cell[begin[pulse] + k]] += back[k]


@compiled
@no_type_check
def add_to_cells(place, value, west, south, spacing, result, low, high):
    """Add values under the nodes of the pulses from `low` to `high` to the cells around them."""
    rows, columns = result.shape
    for pulse in range(low, high):
        for node in range(place.shape[1]):
            i, j, b, a = corner_of(place[pulse, node, 0], place[pulse, node, 1], west, south, spacing, rows, columns)
            node_value = value[pulse, node]
            result[i, j] += node_value * (1 - a) * (1 - b)
            result[i, j + 1] += node_value * a * (1 - b)
            result[i + 1, j] += node_value * (1 - a) * b
            result[i + 1, j + 1] += node_value * a * b
