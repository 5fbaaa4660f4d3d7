"""The DEM method "linear": linear interpolation between the points."""

from typing import Literal

from sionna_radar.mapping.gridding import grid_points
from sionna_radar.mapping.linear_uncertainty import linear_uncertainty
from sionna_radar.mapping.mapper import Estimate, MapInputs, register_dem_method


@register_dem_method("linear")
class Linear:
    """Interpolates between the located echoes."""

    profiles: Literal["unused"] = "unused"

    def __call__(self, given: MapInputs) -> Estimate:
        """Return the DEM and its uncertainty."""
        found = grid_points(given.points, given.grid, given.max_gap_m, given.shadow_incidence_rad)
        uncertainty = linear_uncertainty(found, given.heights())
        return Estimate(dem=found.dem) if uncertainty is None else Estimate.known_by(found.dem, uncertainty)
