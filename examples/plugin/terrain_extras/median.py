"""A DEM method: the median height of the points about each cell."""

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial import KDTree

from sionna_radar import Parameters, Raster, register_dem_method
from sionna_radar.scenario import Real


class MedianParameters(Parameters):
    """radius_m: how far about the centre of a cell points count."""

    radius_m: Annotated[Real, Field(gt=0, le=1000)] = 3.0


@register_dem_method("median", MedianParameters)
class Median:
    """Needs points alone, so that it works with every sensor."""

    profiles = "unused"

    def __init__(self, parameters):
        self.radius_m = parameters.radius_m

    def __call__(self, inputs):
        place, height = inputs.points.position_m[:, :2], inputs.points.position_m[:, 2]
        near = KDTree(place).query_ball_point(inputs.grid.centres_m, self.radius_m)
        heights = np.array([np.median(height[found]) if found else np.nan for found in near])
        return Raster(grid=inputs.grid, height_m=heights.reshape(inputs.grid.shape))
