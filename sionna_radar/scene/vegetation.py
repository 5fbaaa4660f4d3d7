"""Vegetation stands as a gridded layer above the ground, which rays traverse."""

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.foundation.decibels import from_db
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Grid, Heights
from sionna_radar.scene.crops import Planting

logger = logging.getLogger("sionna_radar")

# Spacing of the grid, which limits the accuracy of the borders of stands; coarser above the number of cells.
SPACING_M, MAX_CELLS = 0.25, 4_000_000
# Spacing of the grid of plants in rows: at least so fine that their smallest length has so many cells.
FINEST_SPACING_M, CELLS_ACROSS = 0.1, 3.0
# Cells over the smallest length of rows above which they are not resolved, with a warning.
COARSEST = 1.1
# Nepers of power per decibel.
NEPERS = math.log(10.0) / 10.0
TALLEST_M = 100.0
# Larger heights in a file are undeclared nodata values.
NO_PLANT_M = 1000.0


@dataclass(frozen=True, kw_only=True)
class Stand:
    """A stand of plants.

    polygon_m: corners of its outline; None for all that its file covers.
    height_m: of its top above the ground; None for that of its file.
    path: a raster of heights above ground in metres, or a point cloud, whose highest points of some classes are taken
        in cells of `cloud_spacing_m`.
    least_height_m: below which nothing stands.
    extinction_db_per_m, backscatter_db_per_m: of power, one way; cross-section per volume.
    light_extinction_db_per_m: of light; None for that of the radar.
    planting: of plants in rows; None for an even stand.
    """

    polygon_m: tuple[tuple[float, float], ...] | None = None
    height_m: float | None = None
    path: FilePath | None = None
    of_cloud: bool = False
    classes: tuple[int, ...] = (3, 4, 5)
    cloud_spacing_m: float = 1.0
    least_height_m: float = 0.5
    extinction_db_per_m: float
    backscatter_db_per_m: float
    light_extinction_db_per_m: float | None = None
    planting: Planting | None = None

    @property
    def light_db_per_m(self) -> float:
        """One-way extinction of light."""
        light_db_per_m = self.light_extinction_db_per_m
        return self.extinction_db_per_m if light_db_per_m is None else light_db_per_m


# Returns heights of plants at horizontal positions from a raster file; NaN without data.
CanopyHeights = Callable[[Stand, str, Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]


@dataclass(frozen=True, kw_only=True)
class PlantCover:
    """All stands of a scene.

    grid: cells of the stands; stand: index of the stand in each, -1 for none.
    plant_m, top_m: heights of plants above ground, NaN without plants, and of their tops in the world frame, minus
        infinity without plants.
    bottom_m: height of the lowest leaves in the world frame; minus infinity where they reach the ground.
    extinction_per_m, backscatter_per_m: of each stand: one-way extinction of power in nepers per metre; cross-section
        per volume.
    light_extinction_per_m: the same extinction for light.
    """

    grid: Grid
    stand: Int[np.ndarray, "row column"]
    plant_m: Float[np.ndarray, "row column"]
    top_m: Float[np.ndarray, "row column"]
    bottom_m: Float[np.ndarray, "row column"]
    extinction_per_m: Float[np.ndarray, " stand"]
    backscatter_per_m: Float[np.ndarray, " stand"]
    light_extinction_per_m: Float[np.ndarray, " stand"]

    @property
    def highest_m(self) -> float:
        """Height of the tallest plants above ground."""
        return float(np.nanmax(self.plant_m, initial=0.0))

    def tops_m(self, point_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return the heights of the plants' tops at horizontal positions; minus infinity without plants."""
        row, column, in_grid = self.grid.cell_of(point_m)
        return np.where(in_grid, self.top_m[row, column], -np.inf)

    def over(self, grid: Grid) -> Float[np.ndarray, "row column"]:
        """Return the height of the plants in the cells of a map; NaN without plants."""
        return self.at(grid.centres_m).reshape(grid.shape)

    def at(self, place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return the height of the plants at some places; NaN without plants."""
        row, column, in_grid = self.grid.cell_of(place_m)
        return np.where(in_grid, self.plant_m[row, column], np.nan)

    def mean_over(self, grid: Grid) -> Float[np.ndarray, "row column"]:
        """Return the mean height of the plants within each cell of a map; NaN where none stands."""
        total_m, places = np.zeros((2, *grid.shape))
        for height_m in self._within(grid):
            total_m += np.nansum(height_m, axis=2)
            places += np.isfinite(height_m).sum(axis=2)
        return np.where(places > 0, total_m / np.maximum(places, 1), np.nan)

    def fraction_over(self, grid: Grid) -> Float[np.ndarray, "row column"]:
        """Return the share of the area of each cell of a map that is under plants, 0 to 1."""
        lines = [np.isfinite(height_m).mean(axis=2) for height_m in self._within(grid)]
        return np.mean(lines, axis=0)

    def _within(self, grid: Grid) -> Iterator[Float[np.ndarray, "row column place"]]:
        """Yield the heights of plants along lines through the cells of a map; NaN without plants.

        There are two lines and places to each of the plants' cells: where both grids fit, none is on a border.
        """
        places = 2 * math.ceil(grid.spacing_m / self.grid.spacing_m)
        steps_m = ((np.arange(places) + 0.5) / places - 0.5) * grid.spacing_m
        x_m = (grid.x_m[:, None] + steps_m).ravel()
        _, column, _ = self.grid.cell_of(np.column_stack([x_m, np.zeros(len(x_m))]))
        in_columns = (x_m > self.grid.extent_m[0]) & (x_m < self.grid.extent_m[1])
        for step_m in steps_m:
            y_m = grid.y_m + step_m
            row, _, _ = self.grid.cell_of(np.column_stack([np.zeros(len(y_m)), y_m]))
            in_rows = (y_m > self.grid.extent_m[2]) & (y_m < self.grid.extent_m[3])
            height_m = np.where(in_rows[:, None] & in_columns, self.plant_m[row[:, None], column], np.nan)
            yield height_m.reshape(*grid.shape, places)


def vegetation_of(
    stands: Sequence[Stand],
    ground_m: Heights,
    window_m: tuple[float, float, float, float],
    heights: CanopyHeights,
) -> PlantCover | None:
    """Return all stands as one cover; None for none.

    stands: the stands.
    ground_m: returns the height of the bare ground at horizontal positions; NaN beyond the terrain.
    window_m: extent visible to the survey (west, south, east, north), for stands without an outline; large ones are
        clipped to it.
    heights: reads the heights of a stand from its raster.

    Raises ScenarioError if a stand covers no ground.
    Raises InputFileError if a raster of heights cannot be read, or has implausible heights.
    """
    if not stands:
        return None
    west, south, east, north = window_m
    window_corners = np.array([[west, south], [east, south], [east, north], [west, north]])
    corners = [
        window_corners if each_stand.polygon_m is None else np.array(each_stand.polygon_m) for each_stand in stands
    ]
    plantings = [each_stand.planting for each_stand in stands if each_stand.planting]
    finest_m = min([planting.finest_m / CELLS_ACROSS for planting in plantings], default=SPACING_M)
    grid = _grid(corners, window_m, min(max(finest_m, FINEST_SPACING_M), SPACING_M))
    _warn_of_coarse_rows(stands, grid)
    stand, plant_m = np.full(grid.shape, -1, dtype=np.int64), np.full(grid.shape, np.nan)
    low_m = np.full(grid.shape, np.nan)
    for index, (each_stand, corner) in enumerate(zip(stands, corners, strict=True)):
        in_stand = _inside(grid, corner)
        points = grid.centres_m[in_stand.ravel()]
        low, height = _foliage_m(each_stand, index, points, heights)
        if len(points) == 0 and _beyond(corner, window_m) and np.any(np.isfinite(ground_m(corner))):
            continue
        if not np.any(np.isfinite(ground_m(points)) & np.isfinite(height)):
            raise _no_plants(each_stand, index)
        stand[in_stand] = np.where(np.isfinite(height), index, stand[in_stand])
        plant_m[in_stand] = np.where(np.isfinite(height), height, plant_m[in_stand])
        low_m[in_stand] = np.where(np.isfinite(height), low, low_m[in_stand])
    base_m = np.full(grid.shape, np.nan)
    base_m[stand >= 0] = ground_m(grid.centres_m[(stand >= 0).ravel()])
    stand[~np.isfinite(base_m)] = -1
    return PlantCover(
        grid=grid,
        stand=stand,
        plant_m=np.where(stand >= 0, plant_m, np.nan),
        top_m=np.where(stand >= 0, base_m + plant_m, -np.inf),
        bottom_m=np.where((stand >= 0) & np.isfinite(low_m), base_m + low_m, -np.inf),
        extinction_per_m=np.array([NEPERS * each_stand.extinction_db_per_m for each_stand in stands]),
        backscatter_per_m=np.array([from_db(each_stand.backscatter_db_per_m) for each_stand in stands]),
        light_extinction_per_m=np.array([NEPERS * each_stand.light_db_per_m for each_stand in stands]),
    )


def _warn_of_coarse_rows(stands: Sequence[Stand], grid: Grid) -> None:
    """Warn of rows of plants that the cells of a grid do not resolve."""
    for index, each_stand in enumerate(stands):
        if each_stand.planting is not None and grid.spacing_m > COARSEST * each_stand.planting.finest_m:
            message = (
                "vegetation.%d.polygon_m: cells of %.2f m do not resolve rows and gaps of %.2f m; give a smaller "
                "field, or row_width_m = row_spacing_m"
            )
            logger.warning(message, index, grid.spacing_m, each_stand.planting.finest_m)


def _foliage_m(
    stand: Stand, index: int, points: Float[np.ndarray, "n 2"], heights: CanopyHeights
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return heights above ground of the lowest leaves, NaN where they reach it, and of the tops, NaN without plants.

    index: of the stand, for messages; heights: see `vegetation_of`.
    """
    low, height = np.full(len(points), np.nan), np.full(len(points), stand.height_m)
    if stand.planting is not None:
        low, height = stand.planting.foliage_m(points)
        low[low == 0] = np.nan
    if stand.path is not None:
        height = heights(stand, f"vegetation.{index}", points) if len(points) else np.zeros(0)
        if np.any(height > NO_PLANT_M):
            raise InputFileError(
                f"vegetation.{index}.path = {shown(stand.path)}: holds plants {np.nanmax(height):g} m high; give "
                "metres over the ground, and declare the value for none with gdal_edit.py -a_nodata"
            )
        too_tall = int(np.sum(height > TALLEST_M))
        if too_tall:
            message = "vegetation.%d.path = %s: %s of %s cells are higher than %g m, and taken for that"
            logger.warning(message, index, shown(stand.path), f"{too_tall:,}", f"{len(height):,}", TALLEST_M)
        height = np.where(height >= stand.least_height_m, np.minimum(height, TALLEST_M), np.nan)
    return low, height


def _no_plants(stand: Stand, index: int) -> ScenarioError:
    """Return the error of a stand without plants over the terrain that is seen."""
    field, threshold = "polygon_m", ""
    if stand.path is not None:
        field, threshold = "path", f" of least_height_m = {stand.least_height_m:g} or more"
    message = f"holds no plants{threshold} over the terrain that is seen; move or enlarge the stand, or the terrain"
    return ScenarioError.of(f"vegetation.{index}.{field}", message)


def _grid(
    corners_m: Sequence[Float[np.ndarray, "_ 2"]], window_m: tuple[float, float, float, float], spacing_m: float
) -> Grid:
    """Return cells that cover the outlines, clipped to a window if there would be too many."""
    corner_m = np.vstack(corners_m)
    width_m, height_m = np.ptp(corner_m, axis=0)
    if (width_m / spacing_m + 2) * (height_m / spacing_m + 2) > MAX_CELLS:
        corner_m = np.clip(corner_m, window_m[:2], window_m[2:])
    (west, south), (east, north) = corner_m.min(axis=0), corner_m.max(axis=0)
    spacing_m = max(spacing_m, math.sqrt((east - west) * (north - south) / MAX_CELLS))
    return Grid.covering(float(west), float(south), float(east), float(north), spacing_m)


def _beyond(corner_m: Float[np.ndarray, "corner 2"], window_m: tuple[float, float, float, float]) -> bool:
    """Return True if an outline lies outside a window."""
    lower, upper = corner_m.min(axis=0), corner_m.max(axis=0)
    return bool(np.any(lower > window_m[2:]) or np.any(upper < window_m[:2]))


def _inside(grid: Grid, corner_m: Float[np.ndarray, "corner 2"]) -> Bool[np.ndarray, "row column"]:
    """Return the cells whose centres lie in a polygon."""
    from shapely import Polygon, contains_xy

    lower, upper = corner_m.min(axis=0), corner_m.max(axis=0)
    in_box = np.ix_((grid.y_m >= lower[1]) & (grid.y_m <= upper[1]), (grid.x_m >= lower[0]) & (grid.x_m <= upper[0]))
    mask = np.zeros(grid.shape, dtype=bool)
    x, y = np.meshgrid(grid.x_m[in_box[1][0]], grid.y_m[in_box[0][:, 0]])
    if x.size:
        mask[in_box] = contains_xy(Polygon(corner_m), x, y)
    return mask
