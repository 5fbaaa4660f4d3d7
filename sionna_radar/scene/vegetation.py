"""Stands of vegetation over the ground, on a grid that rays are followed through."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.path import Path as Outline

from sionna_radar.foundation.decibel import from_db
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.scenario.vegetation import VegetationTable

# Borders of stands follow the cells of this grid: so fine, unless it would have too many.
SPACING_M, MOST_CELLS = 0.25, 4_000_000
# A decibel of power is so many nepers of it.
NEPERS = math.log(10.0) / 10.0


@dataclass(frozen=True, kw_only=True)
class Vegetation:
    """All stands of a scene.

    grid: cells in which they stand; stand: the number of the stand in each, -1 for none.
    top_m: heights of their tops in the world frame, by cell; minus infinity where none stands.
    height_m, extinction_per_m, backscatter_per_m: of each stand: over the ground; of power, one way, in nepers per
        metre; cross-section per volume.
    """

    grid: Grid
    stand: Int[np.ndarray, "row column"]
    top_m: Float[np.ndarray, "row column"]
    height_m: Float[np.ndarray, " stand"]
    extinction_per_m: Float[np.ndarray, " stand"]
    backscatter_per_m: Float[np.ndarray, " stand"]

    def stands_at(self, place_m: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
        """Return the number of the stand at horizontal positions, -1 for none."""
        row, column, inside = self.grid.cell_of(place_m)
        return np.where(inside, self.stand[row, column], -1)


def vegetation_of(
    tables: Sequence[VegetationTable], ground_m: Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]
) -> Vegetation | None:
    """Return the vegetation of a scenario; None if it has none.

    Raises ScenarioError for a stand that is not on the terrain.
    """
    if not tables:
        return None
    corners = [np.array(table.polygon_m) for table in tables]
    (west, south), (east, north) = np.vstack(corners).min(axis=0), np.vstack(corners).max(axis=0)
    spacing_m = max(SPACING_M, math.sqrt((east - west) * (north - south) / MOST_CELLS))
    grid = Grid.covering(float(west), float(south), float(east), float(north), spacing_m)
    stand = np.full(grid.shape, -1, dtype=np.int64)
    for number, corner in enumerate(corners):
        inside = _inside(grid, corner)
        if not inside.any():
            message = "holds no ground; give corners around an area"
            raise ScenarioError([Problem(f"vegetation.{number}.polygon_m", message)])
        stand[inside] = number
    ground = np.full(grid.shape, np.nan)
    ground[stand >= 0] = ground_m(grid.centres_m[(stand >= 0).ravel()])
    for number in range(len(tables)):
        own = ground[stand == number]
        if len(own) and not np.isfinite(own).any():
            message = "lies beyond the terrain; move it or enlarge the terrain"
            raise ScenarioError([Problem(f"vegetation.{number}.polygon_m", message)])
    stand[~np.isfinite(ground)] = -1
    height_m = np.array([table.height_m for table in tables])
    return Vegetation(
        grid=grid,
        stand=stand,
        top_m=np.where(stand >= 0, np.nan_to_num(ground) + height_m[stand], -np.inf),
        height_m=height_m,
        extinction_per_m=np.array([NEPERS * table.extinction_db_per_m for table in tables]),
        backscatter_per_m=np.array([from_db(table.backscatter_db_per_m) for table in tables]),
    )


def _inside(grid: Grid, corner_m: Float[np.ndarray, "corner 2"]) -> Bool[np.ndarray, "row column"]:
    """Return the cells whose centres lie in a polygon."""
    low, high = corner_m.min(axis=0), corner_m.max(axis=0)
    near = np.ix_((grid.y_m >= low[1]) & (grid.y_m <= high[1]), (grid.x_m >= low[0]) & (grid.x_m <= high[0]))
    inside = np.zeros(grid.shape, dtype=bool)
    x, y = np.meshgrid(grid.x_m[near[1][0]], grid.y_m[near[0][:, 0]])
    if x.size:
        inside[near] = Outline(corner_m).contains_points(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
    return inside


def canopy_over(vegetation: Vegetation, truth: Raster) -> Float[np.ndarray, "row column"]:
    """Return the height of the plants over the cells of a map; NaN where none stand."""
    stand = vegetation.stands_at(truth.grid.centres_m)
    height = np.where(stand >= 0, vegetation.height_m[stand], np.nan)
    return height.reshape(truth.grid.shape)
