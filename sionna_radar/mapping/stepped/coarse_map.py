"""Coarse maps with discontinuities, by semi-global matching over height levels: the starts of a labelling.

Every cell gets one height out of a few levels, smooth where possible and broken where necessary, by semi-global
matching (Hirschmueller 2008, "Stereo Processing by Semiglobal Matching and Mutual Information", IEEE PAMI 30, 328-341)
on the evidence of all echoes for and against every height of every cell (`evidence`): along each of eight directions
dynamic programming finds the cost of the best path of heights that ends at each level of each cell, with one penalty
for a change by one level and one for any jump; the eight costs are added.

Where walls stand close the map depends on the penalties. So maps with smaller and with larger ones are made from the
same evidence, too: rivals, of which `labelling` takes what explains whole profiles better.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.progress import stage
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.echo_model.model import Sightings
from sionna_radar.mapping.options import STEPPED, SteppedParameters
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.stepped.evidence import evidence_against
from sionna_radar.mapping.terrain.heights import plane_through

DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


def path_costs(
    cost: Float32[np.ndarray, "row column level"], options: SteppedParameters = STEPPED
) -> Float32[np.ndarray, "row column level"]:
    """Return the costs of the best paths that end at each level of each cell, the sum over all directions."""
    total, cost = np.zeros_like(cost), np.ascontiguousarray(cost)
    for down, right in DIRECTIONS:
        add_paths(cost, down, right, options.change_nepers, options.jump_nepers, total)
    return total


def choose_levels(
    total: Float32[np.ndarray, "row column level"], options: SteppedParameters = STEPPED
) -> Int[np.ndarray, "row column"]:
    """Return the level of each cell: the highest of those as good as the best, since nothing occludes it from above.

    total: costs of the best paths, see `path_costs`.
    options: penalties of the method.
    """
    good = total <= total.min(axis=-1, keepdims=True) + options.tie_nepers * len(DIRECTIONS)
    return total.shape[-1] - 1 - np.argmax(good[..., ::-1], axis=-1)


MAX_LEVELS = 128
# Factors of the penalties of jumps and of ties with which rivals are made.
RIVALS = (("jump_nepers", 1 / 3), ("jump_nepers", 3.0), ("tie_nepers", 1 / 4), ("tie_nepers", 4.0))
MIN_POINTS = 6


@dataclass(frozen=True)
class CoarseMap:
    """Heights of the cells, whether echoes support them, those under other penalties, and the spacing of the levels."""

    height_m: Float[np.ndarray, "row column"]
    supported: Bool[np.ndarray, "row column"]
    rivals_m: Float[np.ndarray, "rival row column"]
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
    options: SteppedParameters = STEPPED,
) -> CoarseMap:
    """Return the coarse map, block by block; the level is the widest of all blocks.

    sightings: profiles and measured poses.
    points: located echoes.
    grid: cells of the map.
    options: of the method.
    """
    height, supported = np.zeros(grid.shape), np.zeros(grid.shape, dtype=bool)
    rivals = np.zeros((len(RIVALS), *grid.shape))
    widest = sightings.profiles.cell_m
    blocks, size = list(_blocks(sightings, points, grid, options)), _cells(options.block_m, grid)
    with stage("levels", sum(int(block.near.sum()) for block in blocks)):
        for block in blocks:
            cells = grid.cut(block.rows, block.columns)
            block_map = _block(sightings.rows(block.near), cells, block, options)
            core = slice(block.row, block.row + size), slice(block.column, block.column + size)
            inner = slice(block.row - block.rows.start, None), slice(block.column - block.columns.start, None)
            for whole, block_values in zip((height, supported, *rivals), block_map, strict=True):
                whole[core] = block_values[inner][:size, :size]
            widest = max(widest, float(block.level_m[1] - block.level_m[0]))
    return CoarseMap(height, supported, rivals, widest)


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


def _block(sightings: Sightings, grid: Grid, block: _Block, options: SteppedParameters) -> tuple[np.ndarray, ...]:
    """Return the heights of a block, which of them echoes support, and those of the rivals."""
    against = evidence_against(sightings, grid, block.base_m, block.level_m, options)
    total = path_costs(against, options)
    chosen = choose_levels(total, options)
    supported = np.take_along_axis(against, chosen[..., None], axis=-1)[..., 0] < 0
    rivals = []
    for name, factor in RIVALS:
        other = options.model_copy(update={name: factor * getattr(options, name)})
        cost = total if other.jump_nepers == options.jump_nepers else path_costs(against, other)
        rivals.append(block.base_m + block.level_m[choose_levels(cost, other)])
    return block.base_m + block.level_m[chosen], supported, *rivals


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
