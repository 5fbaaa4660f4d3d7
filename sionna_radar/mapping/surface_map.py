"""DEMs from a surface that is known everywhere: kept where the main beam saw it, empty in shadow and beyond."""

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.accuracy.main_beam import MAIN_BEAM_SHARE
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.mapping.coverage import Illumination
from sionna_radar.mapping.echo_model import Sightings, footprints
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.refinement import FEWEST_PULSES, only, refine
from sionna_radar.mapping.smoothing import Heights, smooth
from sionna_radar.mapping.stepped import step_surface

PULSES_AT_ONCE = 256
# A sample between two nodes that straddle an edge lies off the surface by more than this.
OFF_SURFACE_M = 0.5
# A point of the surface counts as seen when its ray meets the surface no more than this before it.
VISIBLE_M = 0.5


def map_surface(
    method: Literal["smooth", "refined", "stepped"], points: Points, sightings: Sightings, grid: Grid, gap_m: float
) -> Raster:
    """Return the DEM of a survey by a smoothing surface.

    Parameters
    ----------
    method:
        "smooth" lays the surface through the located echoes; "refined" fits it to the whole echoes; "stepped" too, but
        lets it break at walls.
    points:
        Located echoes.
    sightings:
        Profiles and measured poses of the pulses.
    grid:
        Where the DEM is wanted.
    gap_m:
        Widest gap between lit cells that is filled.

    """
    empty = Raster(grid=grid, height_m=np.full(grid.shape, np.nan))
    if len(sightings) < FEWEST_PULSES:
        return empty
    heard = np.ones(grid.shape, dtype=bool)
    match method:
        case "smooth":
            surface = _through(points, grid)
        case "refined":
            surface = refine(sightings, grid)
        case "stepped":
            surface, heard = step_surface(sightings, points, grid, gap_m)
    seen = heard & seen_cells(sightings, surface, grid, gap_m)
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    height = surface.at(x.ravel(), y.ravel()).reshape(grid.shape)
    return Raster(grid=grid, height_m=np.where(seen, height, np.nan))


def seen_cells(sightings: Sightings, surface: Heightfield, grid: Grid, gap_m: float) -> Bool[np.ndarray, "row column"]:
    """Return the cells that the main beam saw, from the measured poses over an estimated surface."""
    illumination = Illumination(grid)
    share = sightings.beam.share
    bright = np.flatnonzero(share >= MAIN_BEAM_SHARE * share.max())
    between = sightings.beam.between[bright]
    for start in range(0, len(sightings), PULSES_AT_ONCE):
        block = np.zeros(len(sightings), dtype=bool)
        block[start : start + PULSES_AT_ONCE] = True
        part = only(sightings, block)
        range_m = footprints(part, surface).range_m
        for pulse in range(len(part)):
            met = np.isfinite(range_m[pulse])
            whole = between @ (~met).astype(float) == 0
            inverse = between @ np.where(met, 1 / np.where(met, range_m[pulse], 1.0), 0.0)
            direction = between @ (sightings.beam.direction @ part.pose.R_world_antenna[pulse].T)
            hit = part.pose.position_m[pulse] + direction[whole] / inverse[whole, None]
            hit = hit[np.abs(hit[:, 2] - surface.at(hit[:, 0], hit[:, 1])) < OFF_SURFACE_M]
            illumination.add(hit, np.broadcast_to(part.pose.position_m[pulse], hit.shape))

    def visible(origin_m: Float[np.ndarray, "ray 3"], point_m: Float[np.ndarray, "ray 3"]) -> Bool[np.ndarray, " ray"]:
        away = point_m - origin_m
        distance = np.linalg.norm(away, axis=1)
        reached = surface.first_hit(origin_m, away / distance[:, None], float(distance.max()) + 1.0)
        return ~(reached < distance - VISIBLE_M)

    x, y = np.meshgrid(grid.x_m, grid.y_m)
    height = surface.at(x.ravel(), y.ravel()).reshape(grid.shape)
    return illumination.mask(gap_m, Raster(grid=grid, height_m=height), visible)


def _through(points: Points, grid: Grid) -> Heightfield:
    """Return the smoothing surface through located echoes, each as uncertain as its range."""
    away = points.position_m - points.origin_m
    steep = np.abs(away[:, 2]) / np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    heights = Heights(points.position_m[:, :2], points.position_m[:, 2], points.range_sigma_m * steep)
    return smooth(heights, grid).surface
