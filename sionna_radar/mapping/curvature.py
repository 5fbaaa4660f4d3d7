"""The information of all echoes about the heights of a grid's cells: A in the normal equations of a surface."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Float32

from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import equal_parts, in_threads
from sionna_radar.mapping.echo_model import Linearised

Information = Callable[[Float[np.ndarray, " cell"]], Float[np.ndarray, " cell"]]


def curvature_on_cells(linear: Linearised, grid: Grid) -> Information:
    """Return the operator W^T F^T F W on the heights of the cells, W taking them to the nodes of the beams."""
    from sionna_radar.mapping.curvature_kernels import curve_cells, onto_cells, touch

    place = linear.place_m
    on = grid.west_m, grid.south_m, grid.spacing_m, grid.rows, grid.columns
    cell, local = np.empty(place.size * 2, dtype=np.int32), np.empty((*place.shape[:2], 4), dtype=np.int32)
    count = touch(place, *on, np.full((grid.rows * grid.columns, 2), -1), cell, local)
    start = np.concatenate([[0], np.cumsum((linear.last - linear.first) * count[1:])])
    if start[-1] > int((linear.last - linear.first).sum()) * place.shape[1]:
        return _by_nodes(linear, grid)
    on_cells, begin = np.empty(start[-1], dtype=np.float32), np.cumsum(count)
    onto = linear.factor, linear.first, linear.last, place, *on, local, count[1:], start, on_cells
    list(in_threads(lambda low, high: onto_cells(*onto, low, high), equal_parts(len(place))))
    cell = cell[: begin[-1]].copy()

    def some(height_m: Float32[np.ndarray, " cell"], result: Float[np.ndarray, " cell"], low: int, high: int) -> None:
        curve_cells(on_cells, start, cell, begin, height_m, result, low, high)

    return _summed(some, len(place))


def _by_nodes(linear: Linearised, grid: Grid) -> Information:
    from sionna_radar.mapping.curvature_kernels import curve_nodes

    factor = linear.factor, linear.first, linear.last, linear.place_m, grid.west_m, grid.south_m, grid.spacing_m

    def some(height_m: Float32[np.ndarray, " cell"], result: Float[np.ndarray, " cell"], low: int, high: int) -> None:
        curve_nodes(*factor, height_m.reshape(grid.shape), result.reshape(grid.shape), low, high)

    return _summed(some, len(linear.place_m))


def _summed(
    some: Callable[[Float32[np.ndarray, " cell"], Float[np.ndarray, " cell"], int, int], None], pulses: int
) -> Information:
    """Return the sum over all pulses of what some of them add."""

    def informed(height_m: Float[np.ndarray, " cell"]) -> Float[np.ndarray, " cell"]:
        single = height_m.astype(np.float32, copy=False)

        def part(low: int, high: int) -> Float[np.ndarray, " cell"]:
            result = np.zeros(height_m.size, dtype=height_m.dtype)
            some(single, result, low, high)
            return result

        first, *others = in_threads(part, equal_parts(pulses))
        for other in others:
            first += other
        return first

    return informed
