"""The DEM method "stepped": a surface that may break at walls."""

from typing import Literal

import numpy as np

from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.mapper import MapInputs, register_dem_method
from sionna_radar.mapping.refinement import FEWEST_PULSES
from sionna_radar.mapping.seen import empty, seen_part
from sionna_radar.mapping.stepped import step_surface


@register_dem_method("stepped")
class Stepped:
    """Fits a surface with steps to the whole echoes."""

    profiles: Literal["required"] = "required"

    def __call__(self, given: MapInputs) -> Raster:
        """Return the DEM."""
        assert given.sightings is not None
        if len(given.sightings) < FEWEST_PULSES:
            return empty(given.grid)
        surface, supported = step_surface(given.sightings, given.points, given.grid, given.max_gap_m, given.progress)
        seen = seen_part(surface, given)
        return Raster(grid=given.grid, height_m=np.where(supported, seen.height_m, np.nan))
