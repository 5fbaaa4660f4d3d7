"""Surfaces by likelihood: "smooth" from the echoes' ranges, "refined" from whole range profiles.

1. The mean range of each echo gives a first surface, the covariance of the terrain, and the noise (`echo_heights`).
2. The forward model (`echo_model.model`) predicts every echo from the current surface. Fisher scoring moves the
   surface to the maximum of the posterior of measured profiles and terrain model, until it rests (`scoring`).

A range cell of a pulse counts as many looks as its speckle is new in it: neighbouring cells overlap, and so do the
footprints of neighbouring pulses (`speckle`).

Only the measured poses, the antenna and the measured profiles are used. A large survey is mapped in square
overlapping tiles; each has its own terrain model, and their surfaces are blended.
"""

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.progress import expect_steps
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.echo_model.model import EchoModel, Linearised, MeanRanges, Sightings
from sionna_radar.mapping.echo_model.speckle import repeats
from sionna_radar.mapping.linear.linear import NOISE_FACTOR_SPREAD
from sionna_radar.mapping.mapper import Estimate, MapInputs
from sionna_radar.mapping.options import SMOOTH, SmoothParameters
from sionna_radar.mapping.refined.scoring import MAX_SCORING_STEPS, most_probable
from sionna_radar.mapping.seen import empty, seen_part
from sionna_radar.mapping.terrain.covariance import fit_covariance
from sionna_radar.mapping.terrain.echo_heights import ROUGH, echo_surface
from sionna_radar.mapping.terrain.kriging import Kriging
from sionna_radar.mapping.terrain.local_relief import calm
from sionna_radar.mapping.terrain.smoothing import smooth
from sionna_radar.mapping.terrain.tiles import (
    MIN_PULSES,
    EachPiece,
    Mapped,
    Tiles,
    TileSurface,
    Tiling,
    pieces_here,
)
from sionna_radar.mapping.terrain.uncertainty import TiledUncertainty, TileUncertainty, information_of


def refine(
    sightings: Sightings, grid: Grid, options: SmoothParameters = SMOOTH, each: EachPiece = pieces_here
) -> Mapped:
    """Return the most probable surface over a grid given whole echoes.

    Parameters
    ----------
    sightings:
        Profiles and measured poses.
    grid:
        Cells of the DEM.
    options:
        Of the method.
    each:
        Has the pieces of all tiles made.

    """
    return Tiles(sightings, grid, refining(options)).mapped(each)


def _smoothed(sightings: Sightings, echoes: MeanRanges, grid: Grid, options: SmoothParameters) -> TileSurface:
    """Return the surface through the mean ranges of echoes."""
    first = echo_surface(sightings, echoes, grid, options)
    return first.smoothed, first, None


def _refined(sightings: Sightings, echoes: MeanRanges, grid: Grid, options: SmoothParameters) -> TileSurface:
    """Return the surface that fits the whole echoes best, from one through their mean ranges."""
    first = echo_surface(sightings, echoes, grid, options, ROUGH)
    volume = sightings.profiles.volume
    reach = first.heights.reach if volume is None else sightings.repeated(echoes.range_m)
    looks = sightings.looks_per_cell / repeats(reach)
    fitted = most_probable(sightings, looks, first.smoothed, first.heights.place_m)
    linearised = partial(_some_linearised, sightings, fitted.surface, looks)
    return fitted, first, information_of(first.heights, linearised, sightings.looks_per_cell)


def _some_linearised(
    sightings: Sightings,
    surface: Heightfield,
    looks: Float[np.ndarray, " pulse"],
    chosen: Int[np.ndarray, " chosen"],
) -> Linearised:
    keep = np.isin(np.arange(len(sightings)), chosen)
    return EchoModel(sightings.rows(keep), surface).linearise(looks[keep])


def smoothing(options: SmoothParameters) -> Tiling:
    """Return the tiling of a map through mean ranges."""
    return Tiling(_smoothed, options.rounds, options)


def refining(options: SmoothParameters) -> Tiling:
    """Return the tiling of a map of whole echoes."""
    return Tiling(_refined, options.rounds + MAX_SCORING_STEPS, options)


class Refined:
    """Fits the surface to the whole echoes."""

    profiles: Literal["required"] = "required"

    def __init__(self, parameters: SmoothParameters = SMOOTH) -> None:
        self.tiling = refining(parameters)

    def __call__(self, given: MapInputs) -> Estimate:
        """Return the DEM and its uncertainty."""
        assert given.sightings is not None
        if len(given.sightings) < MIN_PULSES:
            return Estimate(dem=empty(given.grid))
        expect_steps(self.tiling.steps_over(given.grid))
        mapped = Tiles(given.sightings, given.grid, self.tiling).mapped(given.each_piece)
        return Estimate.known_by(seen_part(mapped.surface, given), mapped.uncertainty)


EVERYWHERE = (-np.inf, np.inf, -np.inf, np.inf)


class Smooth:
    """Fits the most probable surface to the mean ranges of the echoes, each weighted by its uncertainty.

    What the beam does to a mean range on a slope is predicted and taken out. A sensor without range profiles gives its
    located echoes instead.
    """

    profiles: Literal["optional"] = "optional"

    def __init__(self, parameters: SmoothParameters = SMOOTH) -> None:
        self.tiling = smoothing(parameters)

    def __call__(self, given: MapInputs) -> Estimate:
        """Return the DEM and its uncertainty."""
        pulses = len(np.unique(given.points.pulse)) if given.sightings is None else len(given.sightings)
        if pulses < MIN_PULSES:
            return Estimate(dem=empty(given.grid))
        if given.sightings is not None:
            expect_steps(self.tiling.steps_over(given.grid))
            mapped = Tiles(given.sightings, given.grid, self.tiling).mapped(given.each_piece)
            return Estimate.known_by(seen_part(mapped.surface, given), mapped.uncertainty)
        return self._through_points(given)

    def _through_points(self, given: MapInputs) -> Estimate:
        # The system is solved by iterations, whose number shows at the end.
        heights = given.heights()
        # Estimators of ranges know their errors to a factor, which the fit below takes for known.
        ground_m, window = given.microrelief_m, self.tiling.options.window_heights
        measured = heights.above(heights.trend(), ground_m)
        factor = fit_covariance(measured.rows(calm(measured, window)), 1, NOISE_FACTOR_SPREAD).noise_factor
        heights = replace(heights, sigma_m=heights.sigma_m * np.sqrt(factor))
        fitted = smooth(heights, given.grid, window_heights=window, microrelief_m=ground_m)
        kriging = Kriging(fitted.model.covariance, heights, fitted.noise_factor, fitted.model.local)
        own = TileUncertainty.of(EVERYWHERE, kriging, window_heights=window, microrelief_m=ground_m)
        uncertainty = TiledUncertainty((own,))
        return Estimate.known_by(seen_part(fitted.surface, given), uncertainty)
