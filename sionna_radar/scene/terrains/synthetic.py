"""Common parts of all synthetic terrains: their grid, and the scaling of their heights."""

import math

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.scenario.terrain import FlatTerrain, FractalTerrain, HillsTerrain

MAX_SYNTHETIC_CELLS = 16_000_000


def synthetic_grid(terrain: FlatTerrain | HillsTerrain | FractalTerrain) -> Grid:
    """Return the grid whose outermost centres bound the terrain, so that its mesh has the whole size."""
    # The small number keeps 1.1 / 0.1 = 11.000000000000002 from adding a twelfth cell.
    columns, rows = (math.ceil(size / terrain.spacing_m - 1e-9) + 1 for size in terrain.size_m)
    if terrain.spacing_m > min(terrain.size_m):
        message = f"{terrain.spacing_m:g} exceeds the shorter side of terrain.size_m ({min(terrain.size_m):g} m)"
        raise ScenarioError([Problem("terrain.spacing_m", message)])
    if columns * rows > MAX_SYNTHETIC_CELLS:
        message = (
            f"{terrain.spacing_m:g} gives {columns * rows:,} cells, more than {MAX_SYNTHETIC_CELLS:,}; "
            "raise it or lower terrain.size_m"
        )
        raise ScenarioError([Problem("terrain.spacing_m", message)])
    return Grid(
        west_m=-terrain.spacing_m * (columns - 1) / 2,
        south_m=-terrain.spacing_m * (rows - 1) / 2,
        spacing_m=terrain.spacing_m,
        columns=columns,
        rows=rows,
    )


def scaled(surface: Float[np.ndarray, "row column"], grid: Grid, height_m: float) -> Raster:
    """Return a surface shifted and scaled to heights of 0 to `height_m`."""
    lowest, highest = surface.min(), surface.max()
    return Raster(grid=grid, height_m=(surface - lowest) * (height_m / (highest - lowest)))
