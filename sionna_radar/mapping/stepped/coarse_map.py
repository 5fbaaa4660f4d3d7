"""A coarse map with discontinuities, by semi-global matching over height levels.

Semi-global matching on the evidence of all echoes for and against every height of every cell (`evidence`) gives a
map with discontinuities. Surfaces in plain view on this map are then known not to be occluded, and the map is
computed once more.

Every cell gets one height out of a few levels, smooth where possible and broken where necessary, by semi-global
matching (Hirschmueller 2008, "Stereo Processing by Semiglobal Matching and Mutual Information", IEEE PAMI 30, 328-341):
along each of eight directions dynamic programming finds the cost of the best path of heights that ends at each level of
each cell, with one penalty for a change by one level and one for any jump; the eight costs are added.

Each of the eight counts the evidence of the cell itself. Counted once, the sum is the cost of the best heights of all
cells on the eight paths, given the level of the cell (Drory et al. 2014, "Semi-Global Matching: A Principled Derivation
in Terms of Message Passing", GCPR). By how much it rises toward the best level a step away is known, too: the margin of
a cell. It is that of one direction, the mean of eight, whose paths run through the footprints of the same echoes.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.ndimage import minimum_filter1d
from scipy.spatial import KDTree

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.progress import stage
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import chunks, in_threads
from sionna_radar.mapping.echo_model.model import Sightings
from sionna_radar.mapping.options import STEPPED, SteppedParameters
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.stepped.evidence import ROWS_AT_ONCE, Evidence
from sionna_radar.mapping.terrain.heights import plane_through

DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


def choose_levels(
    cost: Float32[np.ndarray, "row column level"], options: SteppedParameters = STEPPED
) -> Int[np.ndarray, "row column"]:
    """Return the level of each cell: the highest of those as good as the best, since nothing occludes it from above.

    cost: evidence against each level of each cell, in nepers.
    options: penalties of the method.
    """
    return _highest_good(path_costs(cost, options), options)


def path_costs(
    cost: Float32[np.ndarray, "row column level"], options: SteppedParameters = STEPPED
) -> Float32[np.ndarray, "row column level"]:
    """Return the costs of the best paths that end at each level of each cell, the sum over all directions."""
    total, cost = np.zeros_like(cost), np.ascontiguousarray(cost)
    for down, right in DIRECTIONS:
        add_paths(cost, down, right, options.change_nepers, options.jump_nepers, total)
    return total


def _highest_good(
    total: Float32[np.ndarray, "row column level"], options: SteppedParameters
) -> Int[np.ndarray, "row column"]:
    good = total <= total.min(axis=-1, keepdims=True) + options.tie_nepers * len(DIRECTIONS)
    return total.shape[-1] - 1 - np.argmax(good[..., ::-1], axis=-1)


def margins(
    cost: Float32[np.ndarray, "row column level"],
    total: Float32[np.ndarray, "row column level"],
    chosen: Int[np.ndarray, "row column"],
    apart: int,
) -> tuple[Float[np.ndarray, "row column"], ...]:
    """Return the likelihood of each cell's level over the best one below and the best one above it, in nepers.

    The third and the fourth number say how many levels away the other ones are, below and above: the root mean square
    over all that are a step away, by their likelihood.

    cost: evidence against each level of each cell, in nepers.
    total: costs of the best paths to it, the sum over all directions.
    chosen: the level of each cell; those within half a step are it as well, as the surface may pass through any of
        them.
    apart: levels of a step: nearer ones are no other side. The margin is infinite where there are none as far away.
    """
    once, count = (total - (len(DIRECTIONS) - 1) * cost) / len(DIRECTIONS), total.shape[-1]
    best = _at(minimum_filter1d(once, 2 * (apart // 2) + 1, axis=-1, mode="nearest"), chosen)
    upward = np.minimum.accumulate(once, axis=-1)
    downward = np.minimum.accumulate(once[..., ::-1], axis=-1)[..., ::-1]
    lower, higher = chosen - apart, chosen + apart
    below = np.where(lower >= 0, _at(upward, np.maximum(lower, 0)) - best, np.inf)
    above = np.where(higher < count, _at(downward, np.minimum(higher, count - 1)) - best, np.inf)
    away = np.arange(count) - chosen[..., None]
    depth, rise = (_rms_levels(once, np.where(side, away, 0)) for side in (away <= -apart, away >= apart))
    return np.maximum(below, 0.0), np.maximum(above, 0.0), depth, rise


def _rms_levels(
    once: Float32[np.ndarray, "row column level"], away: Int[np.ndarray, "row column level"]
) -> Float[np.ndarray, "row column"]:
    """Return the root mean square of distances, in levels, by likelihood; those of zero do not count."""
    cost = np.where(away != 0, once, np.inf)
    best = cost.min(axis=-1, keepdims=True)
    likelihood = np.exp(np.where(np.isfinite(best), best, 0.0) - cost)
    total = np.sum(likelihood, axis=-1)
    return np.sqrt(np.sum(likelihood * away**2, axis=-1) / np.where(total > 0, total, 1.0))


def _at(
    cost: Float32[np.ndarray, "row column level"], level: Int[np.ndarray, "row column"]
) -> Float32[np.ndarray, "row column"]:
    return np.asarray(np.take_along_axis(cost, level[..., None], axis=-1)[..., 0])


# Passes over the pulses of a block: evidence from echoes, then also from visibility.
PASSES = 2
MAX_LEVELS = 128
MIN_POINTS = 6


@dataclass(frozen=True)
class CoarseMap:
    """Heights of the cells, whether echoes support them, and the spacing of the levels.

    below, above: by how many nepers each height is likelier than the best one a step or more below, or above it.
    depth_m, rise_m: how far below and above it those are, the root mean square by likelihood; 0 without any.
    """

    height_m: Float[np.ndarray, "row column"]
    supported: Bool[np.ndarray, "row column"]
    below: Float[np.ndarray, "row column"]
    above: Float[np.ndarray, "row column"]
    depth_m: Float[np.ndarray, "row column"]
    rise_m: Float[np.ndarray, "row column"]
    level_m: float


@dataclass(frozen=True, kw_only=True)
class _Block:
    """A block of cells of the coarse map, with the cells around it that its pulses reach.

    row, column: its first cell; rows, columns: all cells; near: pulses that look at them.
    base_m, level_m: base heights of the cells, and the levels above them.
    """

    row: int
    column: int
    rows: slice
    columns: slice
    near: Bool[np.ndarray, " pulse"]
    base_m: Float[np.ndarray, "row column"]
    level_m: Float[np.ndarray, " level"]


def coarse_map(
    sightings: Sightings,
    points: Points,
    grid: Grid,
    axis_m: Float[np.ndarray, "pulse 3"],
    options: SteppedParameters = STEPPED,
) -> CoarseMap:
    """Return the coarse map, block by block; the level is the widest of all blocks.

    sightings: profiles and measured poses.
    points: located echoes.
    grid: cells of the map.
    axis_m: where on their axes the echoes of the pulses are.
    options: of the method.
    """
    height, supported = np.zeros(grid.shape), np.zeros(grid.shape, dtype=bool)
    below, above, depth, rise = np.zeros((4, *grid.shape))
    widest = sightings.profiles.cell_m
    blocks, size = list(_blocks(sightings, points, grid, options)), _cells(options.block_m, grid)
    with stage("levels", PASSES * sum(int(block.near.sum()) for block in blocks)):
        for block in blocks:
            cells = grid.cut(block.rows, block.columns)
            block_map = _block(sightings.rows(block.near), axis_m[block.near], cells, block, options)
            core = slice(block.row, block.row + size), slice(block.column, block.column + size)
            inner = slice(block.row - block.rows.start, None), slice(block.column - block.columns.start, None)
            for whole, block_values in zip((height, supported, below, above, depth, rise), block_map, strict=True):
                whole[core] = block_values[inner][:size, :size]
            widest = max(widest, float(block.level_m[1] - block.level_m[0]))
    return CoarseMap(height, supported, below, above, depth, rise, widest)


def _cells(length_m: float, grid: Grid) -> int:
    """Return a length in cells, at least one."""
    return max(1, round(length_m / grid.spacing_m))


def _blocks(sightings: Sightings, points: Points, grid: Grid, options: SteppedParameters) -> Iterator[_Block]:
    """Yield the blocks of cells with enough points, and pulses that look at them."""
    size, margin = _cells(options.block_m, grid), _cells(options.block_margin_m, grid)
    for row in range(0, grid.rows, size):
        for column in range(0, grid.columns, size):
            rows = slice(max(row - margin, 0), min(row + size + margin, grid.rows))
            columns = slice(max(column - margin, 0), min(column + size + margin, grid.columns))
            block = grid.cut(rows, columns)
            here = points.position_m[_within(points.position_m[:, :2], block, 0.0)]
            if len(here) < MIN_POINTS:
                continue
            base, level = _levels(here, block, sightings.profiles.cell_m, options.level_margin_m)
            span_m = float(base.min() + level[0]), float(base.max() + level[-1])
            near = looking_at(sightings, block, span_m, margin * grid.spacing_m)
            if near.any():
                yield _Block(row=row, column=column, rows=rows, columns=columns, near=near, base_m=base, level_m=level)


def _block(
    sightings: Sightings,
    axis_m: Float[np.ndarray, "pulse 3"],
    grid: Grid,
    block: _Block,
    options: SteppedParameters,
) -> tuple[np.ndarray, ...]:
    """Return the heights of a block, from echoes and then visibility, which of them echoes support, and margins."""
    base_m, level_m = block.base_m, block.level_m
    evidence = Evidence(sightings, grid, base_m, level_m, options)
    height = base_m + level_m[choose_levels(evidence.lowest, options)]
    nearest = KDTree(axis_m[:, :2]).query(grid.centres_m)[1]
    origin_m = sightings.pose.position_m[nearest].reshape(*grid.shape, 3)
    in_view = lowest_in_view_m(height, grid, origin_m) + float(level_m[1] - level_m[0])
    evidence.know_in_view(in_view)
    against = evidence.lowest
    total = path_costs(against, options)
    chosen = _highest_good(total, options)
    supported = np.take_along_axis(against, chosen[..., None], axis=-1)[..., 0] < 0
    step_levels = int(np.ceil(options.step_levels))
    # Row by row: several arrays of all cells and levels would be the largest of a map.
    of_rows = [
        margins(c[None], t[None], level[None], step_levels) for c, t, level in zip(against, total, chosen, strict=True)
    ]
    below, above, depth, rise = map(np.concatenate, zip(*of_rows, strict=True))
    spacing_m = float(level_m[1] - level_m[0])
    return base_m + level_m[chosen], supported, below, above, depth * spacing_m, rise * spacing_m


def lowest_in_view_m(
    height_m: Float[np.ndarray, "row column"], grid: Grid, origin_m: Float[np.ndarray, "row column 3"]
) -> Float[np.ndarray, "row column"]:
    """Return the height over each cell above which a point is visible from its origin, over a map."""
    from sionna_radar.mapping.stepped.evidence import lowest_in_view

    x, y = np.meshgrid(grid.x_m, grid.y_m)
    east, north, up = np.moveaxis(origin_m, -1, 0)
    distance = np.maximum(np.hypot(east - x, north - y), 1e-6)
    drop = float(np.max(up - height_m.min()))
    steepest = float(np.max(distance)) * float(np.ptp(height_m)) / max(drop, 1e-6)
    # Nothing outside the map occludes.
    steepest = min(steepest, float(np.hypot(*grid.shape)) * grid.spacing_m)
    farthest = len(np.arange(grid.spacing_m, steepest + grid.spacing_m, grid.spacing_m))
    on = grid.x_m, grid.y_m, grid.west_m, grid.south_m, grid.spacing_m, np.ascontiguousarray(origin_m), farthest
    result = np.empty(grid.shape)
    list(in_threads(lambda *some: lowest_in_view(height_m, *on, result, *some), chunks(grid.rows, ROWS_AT_ONCE)))
    return result


def _levels(
    point_m: Float[np.ndarray, "n 3"], grid: Grid, cell_m: float, margin_m: float
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, " level"]]:
    """Return a plane through echoes, and levels about it that span them, a range cell apart."""
    plane = plane_through(point_m[:, :2], point_m[:, 2])
    above_m = point_m[:, 2] - plane[0] - point_m[:, :2] @ plane[1:]
    low, high = np.percentile(above_m, [0.5, 99.5]) + np.array([-margin_m, margin_m])
    spacing = max(cell_m, (high - low) / MAX_LEVELS)
    return plane[0] + plane[1] * grid.x_m[None] + plane[2] * grid.y_m[:, None], np.arange(low, high + spacing, spacing)


def looking_at(
    sightings: Sightings, grid: Grid, span_m: tuple[float, float], margin_m: float
) -> Bool[np.ndarray, " pulse"]:
    """Return True where the beam axis of each pulse passes near a grid at either of two heights, m."""
    position, axis = sightings.pose.position_m, sightings.pose.boresight
    near = np.zeros(len(sightings), dtype=bool)
    for height_m in span_m:
        reach = np.clip((height_m - position[:, 2]) / np.minimum(axis[:, 2], -0.05), 0.0, sightings.reach_m)
        near |= _within((position + reach[:, None] * axis)[:, :2], grid, margin_m)
    return near


def _within(place_m: Float[np.ndarray, "n 2"], grid: Grid, margin_m: float) -> Bool[np.ndarray, " n"]:
    west, east, south, north = grid.extent_m
    x, y = place_m.T
    inside: Bool[np.ndarray, " n"] = (x > west - margin_m) & (x < east + margin_m)
    return inside & (y > south - margin_m) & (y < north + margin_m)


@compiled
@no_type_check
def add_paths(cost, down, right, change, jump, total):
    """Add the cost of the best paths of heights from one direction: (row, column, level)."""
    rows, columns, levels = cost.shape
    before, here = np.empty((columns, levels), dtype=np.float32), np.empty((columns, levels), dtype=np.float32)
    change, jump = np.float32(change), np.float32(jump)
    for i in range(rows):
        row = i if down >= 0 else rows - 1 - i
        for j in range(columns):
            column = j if right >= 0 else columns - 1 - j
            source = column - right
            # A path starts at the border.
            if not 0 <= source < columns or (down != 0 and i == 0):
                for k in range(levels):
                    here[column, k] = cost[row, column, k]
            else:
                past = here[source] if down == 0 else before[source]
                least = past[0]
                for k in range(levels):
                    least = min(least, past[k])
                for k in range(levels):
                    best = min(past[k], least + jump)
                    if k > 0:
                        best = min(best, past[k - 1] + change)
                    if k < levels - 1:
                        best = min(best, past[k + 1] + change)
                    here[column, k] = cost[row, column, k] + (best - least)
            for k in range(levels):
                total[row, column, k] += here[column, k]
        before, here = here, before
