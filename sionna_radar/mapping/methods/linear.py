"""The DEM method "linear": linear interpolation between the points."""

from typing import Literal

from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.gridding import grid_points
from sionna_radar.mapping.mapper import MapInputs, register_dem_method


@register_dem_method("linear")
class Linear:
    """Interpolates between the located echoes."""

    profiles: Literal["unused"] = "unused"

    def __call__(self, given: MapInputs) -> Raster:
        """Return the DEM."""
        return grid_points(given.points, given.grid, given.max_gap_m, given.shadow_incidence_rad)
