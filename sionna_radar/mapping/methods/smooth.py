"""The DEM method "smooth": the most probable surface through the points."""

from typing import Literal

import numpy as np

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.progress import Step, Steps
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.mapping.mapper import MapInputs, register_dem_method
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.refinement import FEWEST_PULSES
from sionna_radar.mapping.seen import empty, seen_part
from sionna_radar.mapping.smoothing import Heights, smooth


@register_dem_method("smooth")
class Smooth:
    """Fits the most probable surface to the located echoes, each weighted by its uncertainty."""

    profiles: Literal["optional"] = "optional"

    def __call__(self, given: MapInputs) -> Raster:
        """Return the DEM."""
        pulses = len(np.unique(given.points.pulse)) if given.sightings is None else len(given.sightings)
        if pulses < FEWEST_PULSES:
            return empty(given.grid)
        # The system is solved by iterations, whose number shows at the end.
        step = Steps(given.progress, "mapping")
        surface = _through(given.points, given.grid, step)
        step.finish()
        return seen_part(surface, given)


def _through(points: Points, grid: Grid, step: Step) -> Heightfield:
    """Return the smoothing surface through located echoes, with the uncertainties of their ranges."""
    away = points.position_m - points.origin_m
    steep = np.abs(away[:, 2]) / np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    heights = Heights(points.position_m[:, :2], points.position_m[:, 2], points.range_sigma_m * steep)
    return smooth(heights, grid, step).surface
