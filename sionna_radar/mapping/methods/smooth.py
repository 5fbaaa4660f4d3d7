"""The DEM method "smooth": the most probable surface through the echoes."""

from dataclasses import replace
from typing import Literal

import numpy as np

from sionna_radar.foundation.progress import Steps
from sionna_radar.mapping.covariance import fit_covariance
from sionna_radar.mapping.kriging import Kriging
from sionna_radar.mapping.linear_uncertainty import NOISE_FACTOR_SPREAD
from sionna_radar.mapping.local_relief import calm
from sionna_radar.mapping.mapper import Estimate, MapInputs, register_dem_method
from sionna_radar.mapping.refinement import SMOOTHING, smooth_echoes, smoothing_steps
from sionna_radar.mapping.seen import empty, seen_part
from sionna_radar.mapping.smoothing import smooth
from sionna_radar.mapping.tiles import FEWEST_PULSES, Tiling
from sionna_radar.mapping.uncertainty import TiledUncertainty, TileUncertainty

EVERYWHERE = (-np.inf, np.inf, -np.inf, np.inf)


@register_dem_method("smooth")
class Smooth:
    """Fits the most probable surface to the mean ranges of the echoes, each weighted by its uncertainty.

    What the beam does to a mean range on a slope is predicted and taken out. A sensor without range profiles gives its
    located echoes instead.
    """

    profiles: Literal["optional"] = "optional"
    tiling: Tiling = SMOOTHING

    def __call__(self, given: MapInputs) -> Estimate:
        """Return the DEM and its uncertainty."""
        pulses = len(np.unique(given.points.pulse)) if given.sightings is None else len(given.sightings)
        if pulses < FEWEST_PULSES:
            return Estimate(dem=empty(given.grid))
        if given.sightings is not None:
            step = Steps(given.progress, "mapping", smoothing_steps(given.grid))
            mapped = smooth_echoes(given.sightings, given.grid, step, given.each_piece)
            return Estimate.known_by(seen_part(mapped.surface, given), mapped.uncertainty)
        return self._through_points(given)

    def _through_points(self, given: MapInputs) -> Estimate:
        # The system is solved by iterations, whose number shows at the end.
        step = Steps(given.progress, "mapping")
        heights = given.heights()
        # Estimators of ranges know their errors to a factor, which the fit below takes for known.
        measured = heights.above(heights.trend())
        factor = fit_covariance(measured.rows(calm(measured)), 1, NOISE_FACTOR_SPREAD).noise_factor
        heights = replace(heights, sigma_m=heights.sigma_m * np.sqrt(factor))
        fitted = smooth(heights, given.grid, step)
        step.finish()
        kriging = Kriging(fitted.model.covariance, heights, fitted.noise_factor, fitted.model.local)
        uncertainty = TiledUncertainty((TileUncertainty.of(EVERYWHERE, kriging),))
        return Estimate.known_by(seen_part(fitted.surface, given), uncertainty)
