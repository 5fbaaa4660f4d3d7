"""The DEM method "canopy": the ground under plants, and their top, from the same echoes.

1. The surface of `smooth` is the reference: it lies between ground and top.
2. For each pulse the likelihood of every height of the ground with every thickness of a layer on it is a table
   (`inference.echo.layer`), pooled over the pulses around each node (`layers`), for a few types of plants.
3. Nodes and their neighbours agree on ground and plants (`two_surfaces`).
4. The ground through all nodes is the new reference; once more from 2.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from sionna_radar.detection.echoes import MIN_SIGMA_CELLS
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.progress import advance, expect_steps
from sionna_radar.foundation.raster import Grid, Quantity, Raster
from sionna_radar.inference.echo.likelihood import mean_ranges
from sionna_radar.inference.echo.speckle import repeats
from sionna_radar.inference.terrain.kriging import Kriging
from sionna_radar.inference.terrain.smoothing import smooth
from sionna_radar.inference.terrain.uncertainty import TiledUncertainty, TileUncertainty
from sionna_radar.mapping.canopy.layers import Tried, node_evidence, types_in
from sionna_radar.mapping.canopy.two_surfaces import TwoSurfaces, two_surfaces
from sionna_radar.mapping.echo_heights import echo_surface
from sionna_radar.mapping.mapper import BOTH, GROUND_ALONE, PLANTS_ALONE, CanopyMap, Estimate, MapInputs
from sionna_radar.mapping.options import CANOPY, CanopyParameters
from sionna_radar.mapping.refined.refinement import EVERYWHERE
from sionna_radar.mapping.seen import empty, visible_surface
from sionna_radar.mapping.tiles import MIN_PULSES

# How far the ground may lie above the reference, and tops above one that the mean echoes make: those of the range that
# a footprint's slope spreads, m.
ABOVE_M, TOPS_ABOVE_M = 0.6, 1.2
ROUNDS = 2
# Steps of the heights: so many a range cell, and no finer than this, m.
STEPS_PER_CELL, LEAST_STEP_M = 4, 0.1


@dataclass(frozen=True)
class CanopyUncertainty:
    """The uncertainty of the ground: of nodes and the ground between them, with what neighbours share.

    model_m: error of the predicted profiles, as a height.
    """

    between: TiledUncertainty
    surfaces: TwoSurfaces
    model_m: float

    def sigma_m(self, grid: Grid, wanted: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """Return the standard deviation of the wanted cells of a grid; NaN elsewhere."""
        sigma = self.between.sigma_m(grid, wanted)
        sigma[wanted] = np.hypot(sigma[wanted], self._shared_m(grid.centres_m[wanted.ravel()]))
        return sigma

    def mean_sigma_m(self, place_m: Float[np.ndarray, "cell 2"], window_m: float) -> float:
        """Return the standard deviation of the mean height over the cells of a window; NaN where it is unknown."""
        shared_m = float(np.mean(self._shared_m(place_m)))
        return float(np.hypot(self.between.mean_sigma_m(place_m, window_m), shared_m))

    def _shared_m(self, place_m: Float[np.ndarray, "cell 2"]) -> Float[np.ndarray, " cell"]:
        nearest = near_nodes(self.surfaces, place_m)[1]
        return np.hypot(np.sqrt(np.mean(self.surfaces.shared_sigma_m[nearest] ** 2, axis=1)), self.model_m)


class Canopy:
    """Maps the ground under plants, and their top."""

    profiles: Literal["required"] = "required"

    def __init__(self, parameters: CanopyParameters = CANOPY) -> None:
        self.options = parameters

    def __call__(self, inputs: MapInputs) -> Estimate:
        """Return the ground, its uncertainty, and the plants on it."""
        sightings, options, grid = inputs.sightings, self.options, inputs.grid
        assert sightings is not None
        if len(sightings) < MIN_PULSES:
            return Estimate(dem=empty(grid))
        expect_steps(options.rounds + ROUNDS)
        echoes = mean_ranges(sightings)
        first = echo_surface(sightings, echoes, grid, options)
        looks = sightings.looks_per_cell / repeats(sightings.repeated(echoes.range_m))
        step_m = max(LEAST_STEP_M, sightings.profiles.cell_m / STEPS_PER_CELL)
        # Evidence changes within half a range cell.
        finer = int(np.ceil(2 * step_m / sightings.profiles.cell_m))
        spacing_m = max(grid.spacing_m, float(np.median(first.heights.spread_m)))
        most_m = options.max_plants_m
        among = Tried(low_m=-most_m, high_m=ABOVE_M, top_m=TOPS_ABOVE_M, thickest_m=most_m, step_m=step_m)
        under = replace(among, low_m=-2 * ABOVE_M, high_m=2 * ABOVE_M, top_m=max(most_m, 2 * ABOVE_M), finer=finer)
        surface, surfaces = first.smoothed.surface, None
        coarse = replace(among, step_m=2 * step_m)
        if not (coarse.enough and under.enough):
            cells = f"range cells of {sightings.profiles.cell_m:.3g} m; set 'refined'"
            message = f"'canopy' tells no plants of {options.max_plants_m:g} m (max_plants_m) from ground in {cells}"
            raise ScenarioError.of("dem.method", message)
        types = types_in(sightings, surface, looks, coarse, 2 * spacing_m, options.plant_types)
        for number in range(ROUNDS):
            evidence = node_evidence(sightings, surface, looks, under if number else among, types, spacing_m)
            if len(evidence.place_m) < MIN_PULSES:
                return Estimate(dem=empty(grid))
            surfaces = two_surfaces(evidence, inputs.microrelief_m, surfaces)
            heights = surfaces.own_heights()
            if len(heights) < MIN_PULSES:
                return Estimate(dem=empty(grid))
            window, ground_m = options.window_heights, inputs.microrelief_m
            smoothed = smooth(heights, grid, window_heights=window, microrelief_m=ground_m)
            surface = smoothed.surface
            advance()
        assert surfaces is not None
        kriging = Kriging(smoothed.model.covariance, heights, smoothed.noise_factor, smoothed.model.local)
        tile = TileUncertainty.of(EVERYWHERE, kriging, window_heights=window, microrelief_m=ground_m)
        # As that of mean ranges.
        model_m = MIN_SIGMA_CELLS * sightings.profiles.cell_m
        uncertainty = CanopyUncertainty(TiledUncertainty((tile,)), surfaces, model_m)
        estimate = Estimate.with_sigma(visible_surface(surface, inputs), uncertainty)
        assert estimate.sigma is not None
        return replace(estimate, canopy=canopy_map(surfaces, estimate.dem, estimate.sigma, spacing_m))


def near_nodes(
    surfaces: TwoSurfaces, place_m: Float[np.ndarray, "place 2"]
) -> tuple[Float[np.ndarray, "place near"], Int[np.ndarray, "place near"]]:
    """Return the distances of the four nodes nearest to each place, and their numbers."""
    distance_m, near = KDTree(surfaces.place_m).query(place_m, k=min(4, len(surfaces.place_m)))
    return distance_m, near


def canopy_map(surfaces: TwoSurfaces, ground: Raster, sigma: Raster, spacing_m: float) -> CanopyMap:
    """Return the plants at the cells of a map of the ground.

    surfaces: what is known at nodes; spacing_m: of their lattice.
    ground, sigma: the map of the ground, and its standard deviation.
    """
    grid, wanted = ground.grid, ground.filled
    centre_m = grid.centres_m[wanted.ravel()]
    distance_m, near = near_nodes(surfaces, centre_m)
    weight = np.exp(-0.5 * (distance_m / (0.5 * spacing_m)) ** 2) + np.finfo(float).tiny
    weight /= weight.sum(axis=1, keepdims=True)
    plants = np.sum(weight * surfaces.plants[near], axis=1)
    by_plants = weight * surfaces.plants[near]
    by_plants /= np.maximum(by_plants.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    height_m = np.sum(by_plants * surfaces.thickness_m[near], axis=1)
    apart_m = surfaces.thickness_m[near] - height_m[:, None]
    sigma_m = np.sqrt(np.sum(by_plants * (surfaces.thickness_sigma_m[near] ** 2 + apart_m**2), axis=1))
    top_sigma_m = np.sqrt(np.sum(by_plants * surfaces.top_sigma_m[near] ** 2, axis=1))
    # The ground is seen where a node's own echoes tell it from the top.
    told = surfaces.own_sigma_m < surfaces.thickness_m / 2
    seen = np.sum(weight * told[near], axis=1) > 0.5
    some = plants > 0.5
    cover = np.where(~some, GROUND_ALONE, np.where(seen, BOTH, PLANTS_ALONE)).astype(float)

    def raster(values: Float[np.ndarray, " cell"], quantity: Quantity) -> Raster:
        height = np.full(grid.shape, np.nan)
        height[wanted] = values
        return Raster(grid=grid, height_m=height, quantity=quantity)

    base_m = ground.height_m[wanted]
    return CanopyMap(
        ground=ground,
        ground_sigma=sigma,
        top=raster(np.where(some, base_m + height_m, base_m), "height"),
        top_sigma=raster(np.where(some, top_sigma_m, sigma.height_m[wanted]), "standard deviation of the height"),
        height=raster(np.where(some, height_m, 0.0), "height difference"),
        height_sigma=raster(np.where(some, sigma_m, np.nan), "standard deviation of the height"),
        plants=raster(plants, "probability"),
        cover=raster(cover, "mask"),
    )
