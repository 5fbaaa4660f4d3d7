"""The DEM method "refined": the surface under which the measured echoes are most likely."""

from typing import Literal

from sionna_radar.foundation.progress import Steps
from sionna_radar.mapping.mapper import Estimate, MapInputs, register_dem_method
from sionna_radar.mapping.refinement import REFINING, refine, refinement_steps
from sionna_radar.mapping.seen import empty, seen_part
from sionna_radar.mapping.tiles import FEWEST_PULSES, Tiling


@register_dem_method("refined")
class Refined:
    """Fits the surface to the whole echoes."""

    profiles: Literal["required"] = "required"
    tiling: Tiling = REFINING

    def __call__(self, given: MapInputs) -> Estimate:
        """Return the DEM and its uncertainty."""
        assert given.sightings is not None
        if len(given.sightings) < FEWEST_PULSES:
            return Estimate(dem=empty(given.grid))
        step = Steps(given.progress, "mapping", refinement_steps(given.grid))
        mapped = refine(given.sightings, given.grid, step, given.each_piece)
        return Estimate.known_by(seen_part(mapped.surface, given), mapped.uncertainty)
