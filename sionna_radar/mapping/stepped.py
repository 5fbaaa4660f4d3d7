"""A DEM of ground with steps: walls stay steep, and each level between them is mapped separately.

1. The evidence of all echoes for and against every height of every cell (`evidence`), and the heights that agree
   best with it and with each other (`levels`), give a coarse map that may have jumps. What this map shows in plain
   view is then known not to be occluded, and the map is computed once more.
2. It is split into parts where neighbours differ by more than a step. A part that alone fills enough main lobes is
   mapped from their whole echoes (`refinement`). This shows how far coarse heights scatter; a smaller part whose
   heights scatter about a plane no more than twice as far becomes that plane, fitted to the echoes on it.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.progress import Progress, Step, Steps, silent
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import in_threads, parts
from sionna_radar.mapping.coverage import closed
from sionna_radar.mapping.echo_model import Sightings
from sionna_radar.mapping.evidence import ROWS_AT_ONCE, evidence_against
from sionna_radar.mapping.levels import choose_levels
from sionna_radar.mapping.mean_ranges import mean_ranges
from sionna_radar.mapping.outlines import with_outlines
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.refinement import FEWEST_PULSES, refine, refinement_steps
from sionna_radar.mapping.stepped_uncertainty import LEAST_SIGMA_M, SteppedUncertainty, beside_borders

# The coarse map is computed in blocks of cells, each with the cells around it that its pulses reach.
BLOCK_CELLS, MARGIN_CELLS = 120, 24
# Over the pulses of a block: from the echoes, and then also from visibility.
PASSES = 2
MARGIN_M = 3.0
MOST_LEVELS = 128
# A step is more than this many levels, and steeper than 45 deg.
STEP_LEVELS = 4
FEWEST_CELLS = 6
PLANE_ROUNDS, OUTLIER_SPREADS, BESIDE_CELLS = 4, 4.0, 2


@dataclass(frozen=True)
class SteppedMap:
    """A surface with steps, the cells supported by an echo, and how well they are known."""

    surface: Heightfield
    supported: Bool[np.ndarray, "row column"]
    uncertainty: SteppedUncertainty


def step_surface(
    sightings: Sightings, points: Points, grid: Grid, gap_m: float, progress: Progress = silent
) -> SteppedMap:
    """Return the most probable surface, with steps.

    Parameters
    ----------
    sightings:
        Profiles and measured poses.
    points:
        Located echoes.
    grid:
        Cells of the DEM.
    gap_m:
        Widest gap, within a part, that is filled between cells supported by echoes.
    progress:
        Called for the pulses of the coarse map ("levels"), and for the steps in its parts ("mapping").

    """
    coarse, supported, level_m = _coarse(sightings, points, grid, progress)
    part = _parts(coarse, max(STEP_LEVELS * level_m, grid.spacing_m))
    whole = _whole_part(sightings, part, grid)
    sigma = np.zeros(grid.shape)
    height, refined, filled = coarse.copy(), np.zeros(grid.shape, dtype=bool), supported.copy()
    windows = {int(number): _window(part == number) for number in np.unique(part)}
    own_pulses = {number: whole == number for number in windows}
    alone = [number for number, own in own_pulses.items() if own.sum() >= FEWEST_PULSES]
    step = Steps(progress, "mapping", len(windows) + sum(refinement_steps(grid.cut(*windows[n])) for n in alone))
    for number, window in windows.items():
        inside = part == number
        filled[window] |= inside[window] & closed((supported & inside)[window], gap_m, grid.spacing_m)
        if number in alone:
            cells = grid.cut(*window)
            mapped = refine(sightings.rows(own_pulses[number]), cells, step)
            known = mapped.uncertainty.sigma_m(cells, inside[window])
            height[window] = np.where(inside[window], mapped.surface.height_m, height[window])
            sigma[window] = np.where(inside[window], known, sigma[window])
            refined |= inside
        step()
    spread_m = max(_spread((coarse - height)[refined & supported]), level_m / 2)
    for number in np.unique(part[~refined]):
        inside = part == number
        height[inside], sigma[inside] = _plane(coarse, inside, spread_m, points, grid)
    axis_m = sightings.pose.position_m + mean_ranges(sightings).range_m[:, None] * sightings.pose.boresight
    step_m = max(STEP_LEVELS * level_m, grid.spacing_m)
    height = with_outlines(sightings, axis_m, height, part, filled, grid, step_m, spread_m)
    sigma = np.where(np.isfinite(sigma), sigma, spread_m)
    return SteppedMap(Heightfield(grid=grid, height_m=height), filled, beside_borders(sigma, height, part))


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


def _coarse(
    sightings: Sightings, points: Points, grid: Grid, progress: Progress
) -> tuple[Float[np.ndarray, "row column"], Bool[np.ndarray, "row column"], float]:
    """Return heights of the cells by levels, block by block, whether echoes support them, and the widest level."""
    height, supported = np.zeros(grid.shape), np.zeros(grid.shape, dtype=bool)
    widest = sightings.profiles.cell_m
    axis_m = sightings.pose.position_m + mean_ranges(sightings).range_m[:, None] * sightings.pose.boresight
    blocks = list(_blocks(sightings, points, grid))
    step = Steps(progress, "levels", PASSES * sum(int(block.near.sum()) for block in blocks))
    for block in blocks:
        cells = grid.cut(block.rows, block.columns)
        found, for_it = _block(sightings.rows(block.near), axis_m[block.near], cells, block, step)
        core = slice(block.row, block.row + BLOCK_CELLS), slice(block.column, block.column + BLOCK_CELLS)
        inner = slice(block.row - block.rows.start, None), slice(block.column - block.columns.start, None)
        height[core] = found[inner][:BLOCK_CELLS, :BLOCK_CELLS]
        supported[core] = for_it[inner][:BLOCK_CELLS, :BLOCK_CELLS]
        widest = max(widest, float(block.level_m[1] - block.level_m[0]))
    step.finish()
    return height, supported, widest


def _blocks(sightings: Sightings, points: Points, grid: Grid) -> Iterator[_Block]:
    """Yield the blocks of cells with enough points, and pulses that look at them."""
    for row in range(0, grid.rows, BLOCK_CELLS):
        for column in range(0, grid.columns, BLOCK_CELLS):
            rows = slice(max(row - MARGIN_CELLS, 0), min(row + BLOCK_CELLS + MARGIN_CELLS, grid.rows))
            columns = slice(max(column - MARGIN_CELLS, 0), min(column + BLOCK_CELLS + MARGIN_CELLS, grid.columns))
            block = grid.cut(rows, columns)
            here = points.position_m[_within(points.position_m[:, :2], block, 0.0)]
            if len(here) < FEWEST_CELLS:
                continue
            base, level = _levels(here, block, sightings.profiles.cell_m)
            near = _looking_at(sightings, block, float(base.min() + level[0]), float(base.max() + level[-1]))
            if near.any():
                yield _Block(row=row, column=column, rows=rows, columns=columns, near=near, base_m=base, level_m=level)


def _block(
    sightings: Sightings, axis_m: Float[np.ndarray, "pulse 3"], grid: Grid, block: _Block, step: Step
) -> tuple[Float[np.ndarray, "row column"], Bool[np.ndarray, "row column"]]:
    """Return the heights of a block, from the echoes and then also from visibility, and which echoes support."""
    base_m, level_m = block.base_m, block.level_m
    height = base_m + level_m[choose_levels(evidence_against(sightings, grid, base_m, level_m, step=step))]
    nearest = KDTree(axis_m[:, :2]).query(grid.centres_m)[1]
    origin_m = sightings.pose.position_m[nearest].reshape(*grid.shape, 3)
    in_view = lowest_in_view_m(height, grid, origin_m) + float(level_m[1] - level_m[0])
    against = evidence_against(sightings, grid, base_m, level_m, in_view, step)
    chosen = choose_levels(against)
    supported = np.take_along_axis(against, chosen[..., None], axis=-1)[..., 0] < 0
    return base_m + level_m[chosen], supported


def lowest_in_view_m(
    height_m: Float[np.ndarray, "row column"], grid: Grid, origin_m: Float[np.ndarray, "row column 3"]
) -> Float[np.ndarray, "row column"]:
    """Return the height over each cell above which a point is visible from its origin, over a map."""
    from sionna_radar.mapping.evidence_kernels import lowest_in_view

    x, y = np.meshgrid(grid.x_m, grid.y_m)
    east, north, up = np.moveaxis(origin_m, -1, 0)
    distance = np.maximum(np.hypot(east - x, north - y), 1e-6)
    drop = float(np.max(up - height_m.min()))
    steepest = float(np.max(distance)) * float(np.ptp(height_m)) / max(drop, 1e-6)
    farthest = len(np.arange(grid.spacing_m, steepest + grid.spacing_m, grid.spacing_m))
    on = grid.x_m, grid.y_m, grid.west_m, grid.south_m, grid.spacing_m, np.ascontiguousarray(origin_m), farthest
    result = np.empty(grid.shape)
    list(in_threads(lambda *some: lowest_in_view(height_m, *on, result, *some), parts(grid.rows, ROWS_AT_ONCE)))
    return result


def _levels(
    point_m: Float[np.ndarray, "n 3"], grid: Grid, cell_m: float
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, " level"]]:
    """Return a plane through some echoes, and levels around it that span them, a range cell apart."""
    design = np.column_stack([np.ones(len(point_m)), point_m[:, :2]])
    plane = np.linalg.lstsq(design, point_m[:, 2], rcond=None)[0]
    low, high = np.percentile(point_m[:, 2] - design @ plane, [0.5, 99.5]) + np.array([-MARGIN_M, MARGIN_M])
    spacing = max(cell_m, (high - low) / MOST_LEVELS)
    return plane[0] + plane[1] * grid.x_m[None] + plane[2] * grid.y_m[:, None], np.arange(low, high + spacing, spacing)


def _parts(height_m: Float[np.ndarray, "row column"], step_m: float) -> Int[np.ndarray, "row column"]:
    """Return the part of each cell: neighbours within a part differ by less than a step; tiny parts join others."""
    number = np.arange(height_m.size).reshape(height_m.shape)
    along = np.abs(np.diff(height_m, axis=1)) <= step_m
    across = np.abs(np.diff(height_m, axis=0)) <= step_m
    start = np.concatenate([number[:, :-1][along], number[:-1][across]])
    end = np.concatenate([number[:, 1:][along], number[1:][across]])
    graph = coo_matrix((np.ones(len(start), dtype=bool), (start, end)), shape=(height_m.size, height_m.size))
    label = connected_components(graph, directed=False)[1].reshape(height_m.shape)
    crumb = np.bincount(label.ravel())[label] < FEWEST_CELLS
    if crumb.all():
        return np.zeros(height_m.shape, dtype=np.int64)
    row, column = distance_transform_edt(crumb, return_distances=False, return_indices=True)
    joined: Int[np.ndarray, "row column"] = label[row, column]
    return joined


def _whole_part(sightings: Sightings, part: Int[np.ndarray, "row column"], grid: Grid) -> Int[np.ndarray, " pulse"]:
    """Return the part of the map that contains the main lobe of each pulse; -1 if in more than one."""
    pose = sightings.pose
    range_m = mean_ranges(sightings).range_m
    place = pose.position_m + range_m[:, None] * pose.boresight
    reach_m = range_m * sightings.beam.elevation.max() / np.maximum(-pose.boresight[:, 2], 0.05)
    row, column, inside = grid.cell_of(place)
    within_one = inside & (_to_border_m(part, grid)[row, column] > reach_m)
    return np.where(within_one, part[row, column], -1)


def _plane(
    coarse: Float[np.ndarray, "row column"],
    inside: Bool[np.ndarray, "row column"],
    spread_m: float,
    points: Points,
    grid: Grid,
) -> tuple[Float[np.ndarray, " cell"], float]:
    """Return the plane through a part's coarse heights, moved onto its echoes, and its standard deviation.

    Heights that are not planar are returned as they are.
    """
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    design = np.column_stack([np.ones(int(inside.sum())), x[inside], y[inside]])
    height = coarse[inside]
    # Heights next to a step are biased toward the other side.
    deep = distance_transform_edt(inside)[inside] > BESIDE_CELLS
    deep = deep if deep.sum() >= FEWEST_CELLS else np.ones(len(height), dtype=bool)
    kept = deep
    for _ in range(PLANE_ROUNDS):
        fit = np.linalg.lstsq(design[kept], height[kept], rcond=None)[0]
        rest = height - design @ fit
        if _spread(rest[deep]) > 2 * spread_m:
            return height, spread_m
        kept = deep & (np.abs(rest) <= OUTLIER_SPREADS * spread_m)
        if kept.sum() < FEWEST_CELLS:
            return height, spread_m
    row, column, on_grid = grid.cell_of(points.position_m)
    above = points.position_m[:, 2] - fit[0] - points.position_m[:, :2] @ fit[1:]
    on = on_grid & inside[row, column] & (np.abs(above) < OUTLIER_SPREADS * spread_m)
    moved: Float[np.ndarray, " cell"] = design @ fit + (float(np.median(above[on])) if on.any() else 0.0)
    sigma_m = max(spread_m / np.sqrt(max(int(on.sum()), 1)), LEAST_SIGMA_M)
    return moved, sigma_m


def _spread(values: Float[np.ndarray, " n"]) -> float:
    """Return a robust standard deviation about zero: that of a normal distribution with the same middle half."""
    return 1.4826 * float(np.median(np.abs(values))) if len(values) else 0.0


def _to_border_m(part: Int[np.ndarray, "row column"], grid: Grid) -> Float[np.ndarray, "row column"]:
    """Return how far each cell is from the border of its part."""
    border = np.zeros(part.shape, dtype=bool)
    along, across = part[:, 1:] != part[:, :-1], part[1:] != part[:-1]
    border[:, 1:] |= along
    border[:, :-1] |= along
    border[1:] |= across
    border[:-1] |= across
    distance: Float[np.ndarray, "row column"] = distance_transform_edt(~border) * grid.spacing_m
    return distance if border.any() else np.full(part.shape, np.inf)


def _looking_at(sightings: Sightings, grid: Grid, low_m: float, high_m: float) -> Bool[np.ndarray, " pulse"]:
    """Return which pulses' axes come near the cells of a grid between two heights."""
    position, axis = sightings.pose.position_m, sightings.pose.boresight
    near = np.zeros(len(sightings), dtype=bool)
    for height_m in (low_m, high_m):
        reach = np.clip((height_m - position[:, 2]) / np.minimum(axis[:, 2], -0.05), 0.0, sightings.reach_m)
        near |= _within((position + reach[:, None] * axis)[:, :2], grid, MARGIN_CELLS * grid.spacing_m)
    return near


def _window(inside: Bool[np.ndarray, "row column"]) -> tuple[slice, slice]:
    """Return the rows and columns that contain the given cells."""
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _within(place_m: Float[np.ndarray, "n 2"], grid: Grid, margin_m: float) -> Bool[np.ndarray, " n"]:
    west, east, south, north = grid.extent_m
    x, y = place_m.T
    inside: Bool[np.ndarray, " n"] = (x > west - margin_m) & (x < east + margin_m)
    return inside & (y > south - margin_m) & (y < north + margin_m)
