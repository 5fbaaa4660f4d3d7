"""The DEM method "stepped": a surface that may break at walls."""

from typing import Literal

from sionna_radar.mapping.mapper import Estimate, MapInputs, register_dem_method
from sionna_radar.mapping.seen import empty, seen_part
from sionna_radar.mapping.stepped import step_surface
from sionna_radar.mapping.tiles import FEWEST_PULSES


@register_dem_method("stepped")
class Stepped:
    """Fits a surface with steps to the whole echoes."""

    profiles: Literal["required"] = "required"

    def __call__(self, given: MapInputs) -> Estimate:
        """Return the DEM and its uncertainty."""
        assert given.sightings is not None
        if len(given.sightings) < FEWEST_PULSES:
            return Estimate(dem=empty(given.grid))
        stepped = step_surface(given.sightings, given.points, given.grid, given.max_gap_m, given.progress)
        seen = seen_part(stepped.surface, given)
        return Estimate.known_by(seen.within(stepped.supported), stepped.uncertainty)
