"""A horizontal plane."""

import numpy as np

from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario.terrain import FlatTerrain
from sionna_radar.scene.landscape import Landscape, TerrainInputs, landscape_of_heights, register_terrain
from sionna_radar.scene.terrains.synthetic import synthetic_grid


@register_terrain("flat", FlatTerrain)
def flat(terrain: FlatTerrain, given: TerrainInputs) -> Landscape:
    """Return level ground at height zero."""
    grid = synthetic_grid(terrain)
    return landscape_of_heights(Raster(grid=grid, height_m=np.zeros(grid.shape)), terrain)
