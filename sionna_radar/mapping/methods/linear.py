"""The DEM method "linear": linear interpolation between the points."""

from typing import Literal

from sionna_radar.mapping import covariance
from sionna_radar.mapping.gridding import grid_points
from sionna_radar.mapping.linear_uncertainty import NOISE_FACTOR_SPREAD, linear_uncertainty
from sionna_radar.mapping.mapper import Estimate, MapInputs, register_dem_method


@register_dem_method("linear")
class Linear:
    """Interpolates between the located echoes."""

    profiles: Literal["unused"] = "unused"

    def __call__(self, given: MapInputs) -> Estimate:
        """Return the DEM and its uncertainty."""
        found = grid_points(given.points, given.grid, given.max_gap_m, given.shadow_incidence_rad)
        # The errors of measured directions are known by their theory, those of ranges to a factor.
        spread = NOISE_FACTOR_SPREAD if given.points.across_sigma_m is None else covariance.NOISE_FACTOR_SPREAD
        uncertainty = linear_uncertainty(found, given.heights(), spread)
        return Estimate(dem=found.dem) if uncertainty is None else Estimate.known_by(found.dem, uncertainty)
