"""Coarse maps with discontinuities, by semi-global matching over height levels: the starts of a labelling.

Every cell gets one height out of a few levels, smooth where possible and broken where necessary, by semi-global
matching (Hirschmueller 2008, "Stereo Processing by Semiglobal Matching and Mutual Information", IEEE PAMI 30, 328-341)
on the evidence of all echoes for and against every height of every cell (`evidence`): along each of eight directions
dynamic programming finds the cost of the best path of heights that ends at each level of each cell, with one penalty
for a change by one level and one for any jump; the eight costs are added.

Where walls stand close the map depends on the penalties. So maps with smaller and with larger ones are made from the
same evidence, too: rivals, of which `labelling` takes what explains whole profiles better.
"""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.progress import stage
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.likelihood import Sightings
from sionna_radar.inference.terrain.heights import plane_through
from sionna_radar.mapping.options import STEPPED, SteppedParameters
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.stepped.evidence import evidence_against

DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


def path_costs(
    cost: Float32[np.ndarray, "row column level"], options: SteppedParameters = STEPPED
) -> Float32[np.ndarray, "row column level"]:
    """Return the costs of the best paths that end at each level of each cell, the sum over all directions."""
    total, cost = np.zeros_like(cost), np.ascontiguousarray(cost)
    for down, right in DIRECTIONS:
        add_paths(cost, down, right, options.pair_nepers, options.jump_nepers, total)
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


@dataclass(frozen=True)
class CoarseMap:
    """Heights of the cells, whether echoes support them, those under other penalties, and the spacing of the levels."""

    height_m: Float[np.ndarray, "row column"]
    supported: Bool[np.ndarray, "row column"]
    rivals_m: Float[np.ndarray, "rival row column"]
    level_m: float


def coarse_map(
    sightings: Sightings,
    points: Points,
    grid: Grid,
    options: SteppedParameters = STEPPED,
) -> CoarseMap:
    """Return the coarse map, over levels about a plane through the echoes located on it.

    sightings: profiles and measured poses.
    points: the echoes located on the map.
    grid: cells of the map.
    options: of the method.
    """
    base, level = _levels(points.position_m, grid, sightings.profiles.cell_m, options.step_levels)
    with stage("levels", len(sightings)):
        against = evidence_against(sightings, grid, base, level, options)
    total = path_costs(against, options)
    chosen = choose_levels(total, options)
    supported = np.take_along_axis(against, chosen[..., None], axis=-1)[..., 0] < 0
    rivals = np.empty((len(RIVALS), *grid.shape))
    for rival, (name, factor) in zip(rivals, RIVALS, strict=True):
        other = options.model_copy(update={name: factor * getattr(options, name)})
        cost = total if other.jump_nepers == options.jump_nepers else path_costs(against, other)
        rival[:] = base + level[choose_levels(cost, other)]
    return CoarseMap(base + level[chosen], supported, rivals, float(level[1] - level[0]))


def _levels(
    point_m: Float[np.ndarray, "n 3"], grid: Grid, cell_m: float, margin: float
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, " level"]]:
    """Return a plane through echoes, and levels about it, a range cell apart, that span them and a margin of levels."""
    plane = plane_through(point_m[:, :2], point_m[:, 2])
    above_m = point_m[:, 2] - plane[0] - point_m[:, :2] @ plane[1:]
    low, high = np.percentile(above_m, [0.5, 99.5])
    spacing = max(cell_m, (high - low) / MAX_LEVELS)
    level = np.arange(low - margin * spacing, high + (margin + 1) * spacing, spacing)
    return plane[0] + plane[1] * grid.x_m[None] + plane[2] * grid.y_m[:, None], level


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
