"""The DEM methods "smooth" (mean ranges) and "refined" (whole range profiles): most probable surfaces.

1. The mean range of each echo gives a first surface, the covariance of the terrain, and the noise (`echo_heights`).
2. The forward model (`inference.echo`) predicts every echo from the current surface. Fisher scoring moves the
   surface to the maximum of the posterior of measured profiles and terrain model, until it rests.

A range cell of a pulse counts as many looks as its speckle is new in it: neighbouring cells overlap, and so do the
footprints of neighbouring pulses (`speckle`).

Only the measured poses, the antenna and the measured profiles are used. A large survey is mapped in square
overlapping tiles; each has its own terrain model, and their surfaces are blended.

Fisher scoring. Each step needs the score of all echoes on the surface reached, and solves for the step with the
expected curvature of the likelihood. The score decides where the iteration ends, and is exact. The curvature only
says by which way: it is computed on the first two surfaces alone, from some of the range cells of each pulse, and the
system is solved on a coarser grid where the echoes carry less information on shorter waves than the prior. Each
step takes such a wave too far by at most half, and the next one comes back.

The steps are mixed (`inference.anderson`): plain ones swing about the maximum or creep.
"""

from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.progress import advance, expect_steps
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import equal_chunks, in_threads
from sionna_radar.inference.anderson import AndersonAcceleration
from sionna_radar.inference.echo.likelihood import BeamFootprints, EchoLikelihood, Linearised, MeanRanges, Sightings
from sionna_radar.inference.echo.speckle import repeats
from sionna_radar.inference.terrain.covariance_fit import fit_covariance
from sionna_radar.inference.terrain.kriging import Kriging
from sionna_radar.inference.terrain.local_relief import low_relief_mask
from sionna_radar.inference.terrain.smoothing import MAX_ITERATIONS, Smoothed, TerrainModel, smooth
from sionna_radar.inference.terrain.uncertainty import TiledUncertainty, TileUncertainty, information_of
from sionna_radar.mapping.echo_heights import echo_surface
from sionna_radar.mapping.linear.linear import UNKNOWN_NOISE_FACTOR_SPREAD
from sionna_radar.mapping.mapper import Estimate, MapInputs
from sionna_radar.mapping.options import SMOOTH, SmoothParameters
from sionna_radar.mapping.refined.curvature import Information, curvature_on_cells
from sionna_radar.mapping.seen import empty, visible_surface
from sionna_radar.mapping.tiles import MIN_PULSES, Mapped, Tiles, TileSurface, Tiling, pieces_here

# Convergence: RMS step over the places of the echoes, m.
CONVERGED_M = 1e-3
# Below this step, ray intersections start from the previous ones, m.
COARSE_M = 0.05
MAX_SCORING_STEPS = 12
# Relative CG tolerance per step; the next step corrects the remainder.
STEP_TOLERANCE = 2e-2
# Iterations that recompute the curvature.
CURVED = 2
# Approximate number of rows that the curvature of a pulse keeps; factors by which the grid of the steps may be coarser,
# and the largest ratio of data to prior information on a wave that it omits (steps converge below 1).
ROWS, COARSER, LEFT_OUT = 24, (4, 2, 1), 0.5


def most_probable(
    sightings: Sightings,
    looks: Float[np.ndarray, " pulse"],
    first: Smoothed,
    place_m: Float[np.ndarray, "pulse 2"],
) -> Smoothed:
    """Return the most probable surface given whole echoes.

    sightings, looks: profiles and measured poses, and the independent looks in each range cell of each pulse.
    first: a surface near it.
    place_m: where the echoes come from; convergence is tested there.
    """
    fitted, acceleration, middle = first, AndersonAcceleration(), first.surface.weights(*place_m.T)
    near: BeamFootprints | None = None
    nearest, least_m, converged = first, np.inf, False
    for number in range(MAX_SCORING_STEPS):
        advance()
        if converged:
            continue
        # Occlusion is recomputed as long as the surface still moves much.
        model = EchoLikelihood(sightings, fitted.surface, near if least_m < COARSE_M else None)
        near = model.footprints
        if number < CURVED:
            times, curvature = _curvature(model, looks, fitted.model)
        score = fitted.model.adjoint(_on_cells(near, model.score(looks), fitted.surface)) - fitted.white
        change = fitted.model.solve(curvature, score, MAX_ITERATIONS, STEP_TOLERANCE, times)
        seen_m = middle @ fitted.model.coloured(change)
        by_m = float(np.sqrt(np.mean(seen_m**2)))
        if by_m < least_m:
            nearest, least_m = fitted, by_m
        fitted, converged = replace(fitted, white=acceleration.next(fitted.white, change, seen_m)), by_m <= CONVERGED_M
    # Where echoes do not fit the terrain model, the iterate with the smallest step is taken.
    return fitted if converged else nearest


def _curvature(
    model: EchoLikelihood, looks: Float[np.ndarray, " pulse"], terrain: TerrainModel
) -> tuple[int, Information]:
    """Return the expected curvature on the cells of a coarser grid, and how much coarser it is."""
    linear = model.linearise(looks, ROWS)
    for times in COARSER:
        grid = terrain.coarser(times)
        curvature = curvature_on_cells(linear, grid)
        information = float(curvature(np.ones(grid.rows * grid.columns)).max()) / times**2
        if terrain.left_out(times) * information <= LEFT_OUT:
            break
    return times, curvature


def _on_cells(
    feet: BeamFootprints, score: Float[np.ndarray, "pulse node"], surface: Heightfield
) -> Float[np.ndarray, " cell"]:
    """Return the score of the heights of cells, from that of the heights under the nodes."""
    from sionna_radar.mapping.refined.curvature import add_to_cells

    grid = surface.grid

    def part(low: int, high: int) -> Float[np.ndarray, " cell"]:
        result = np.zeros(grid.shape)
        add_to_cells(feet.place_m, score, grid.west_m, grid.south_m, grid.spacing_m, result, low, high)
        return result.ravel()

    first, *others = in_threads(part, equal_chunks(len(score)))
    for other in others:
        first += other
    return first


def refine(sightings: Sightings, grid: Grid, options: SmoothParameters = SMOOTH) -> Mapped:
    """Return the most probable surface over a grid given whole echoes.

    sightings: profiles and measured poses.
    grid: cells of the DEM.
    options: of the method.
    """
    return Tiles(sightings, grid, refining(options)).mapped(pieces_here)


def _smoothed(sightings: Sightings, echoes: MeanRanges, grid: Grid, options: SmoothParameters) -> TileSurface:
    """Return the surface through the mean ranges of echoes."""
    first = echo_surface(sightings, echoes, grid, options)
    return first.smoothed, first, None


def _refined(sightings: Sightings, echoes: MeanRanges, grid: Grid, options: SmoothParameters) -> TileSurface:
    """Return the surface that fits the whole echoes best, from one through their mean ranges."""
    first = echo_surface(sightings, echoes, grid, options)
    volume = sightings.profiles.volume
    reach = first.heights.reach if volume is None else sightings.repeated(echoes.range_m)
    looks = sightings.looks_per_cell / repeats(reach)
    fitted = most_probable(sightings, looks, first.smoothed, first.heights.place_m)

    def linearised(chosen: Int[np.ndarray, " chosen"]) -> Linearised:
        keep = np.isin(np.arange(len(sightings)), chosen)
        return EchoLikelihood(sightings.rows(keep), fitted.surface).linearise(looks[keep])

    return fitted, first, information_of(first.heights, linearised, sightings.looks_per_cell)


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

    def __call__(self, inputs: MapInputs) -> Estimate:
        """Return the DEM and its uncertainty."""
        assert inputs.sightings is not None
        if len(inputs.sightings) < MIN_PULSES:
            return Estimate(dem=empty(inputs.grid))
        expect_steps(self.tiling.steps_over(inputs.grid))
        mapped = self.tiles(inputs).mapped(inputs.each_piece)
        return Estimate.with_sigma(visible_surface(mapped.surface, inputs), mapped.uncertainty)

    def tiles(self, inputs: MapInputs) -> Tiles:
        """Return the tiles of a map."""
        assert inputs.sightings is not None
        return Tiles(inputs.sightings, inputs.grid, self.tiling)


EVERYWHERE = (-np.inf, np.inf, -np.inf, np.inf)


class Smooth:
    """Fits the most probable surface to the mean ranges of the echoes, each weighted by its uncertainty.

    What the beam does to a mean range on a slope is predicted and taken out. A sensor without range profiles gives its
    located echoes instead.
    """

    profiles: Literal["optional"] = "optional"

    def __init__(self, parameters: SmoothParameters = SMOOTH) -> None:
        self.tiling = smoothing(parameters)

    def __call__(self, inputs: MapInputs) -> Estimate:
        """Return the DEM and its uncertainty."""
        if len(inputs.points if inputs.sightings is None else inputs.sightings) < MIN_PULSES:
            return Estimate(dem=empty(inputs.grid))
        tiles = self.tiles(inputs)
        if tiles is None:
            return self._through_points(inputs)
        expect_steps(self.tiling.steps_over(inputs.grid))
        mapped = tiles.mapped(inputs.each_piece)
        return Estimate.with_sigma(visible_surface(mapped.surface, inputs), mapped.uncertainty)

    def tiles(self, inputs: MapInputs) -> Tiles | None:
        """Return the tiles of a map of whole echoes; None without those."""
        return None if inputs.sightings is None else Tiles(inputs.sightings, inputs.grid, self.tiling)

    def _through_points(self, inputs: MapInputs) -> Estimate:
        # The system is solved by iterations, whose number shows at the end.
        heights = inputs.heights()
        # Estimators of ranges know their errors to a factor, which the fit below takes for known.
        ground_m, window = inputs.microrelief_m, self.tiling.options.window_heights
        measured = heights.above(heights.trend(), ground_m)
        factor = fit_covariance(
            measured.rows(low_relief_mask(measured, window)), 1, UNKNOWN_NOISE_FACTOR_SPREAD
        ).noise_factor
        heights = replace(heights, sigma_m=heights.sigma_m * np.sqrt(factor))
        fitted = smooth(heights, inputs.grid, window_heights=window, microrelief_m=ground_m)
        kriging = Kriging(fitted.model.covariance, heights, fitted.noise_factor, fitted.model.local)
        uncertainty_of_points = TileUncertainty.of(EVERYWHERE, kriging, window_heights=window, microrelief_m=ground_m)
        uncertainty = TiledUncertainty((uncertainty_of_points,))
        return Estimate.with_sigma(visible_surface(fitted.surface, inputs), uncertainty)
