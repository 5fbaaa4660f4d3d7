"""Visibility mask of an estimated surface: shadow and ground beyond the swath stay empty."""

from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.foundation.threads import chunks_of_bytes
from sionna_radar.inference.echo.likelihood import Sightings, footprints
from sionna_radar.mapping.coverage import Illumination
from sionna_radar.mapping.mapper import MapInputs
from sionna_radar.mapping.points import Points
from sionna_radar.radar.antenna import LIT

# Places along each axis of a point's footprint at which it counts as seen, in standard deviations.
STRIP_PLACES = (-1.0, -0.5, 0.0, 0.5, 1.0)
# A sample between two nodes on opposite sides of an edge is off the surface by more than this.
OFF_SURFACE_M = 0.5
# A point of the surface counts as seen if its ray meets the surface no more than this before it.
VISIBLE_M = 0.5


def visible_surface(surface: Heightfield, inputs: MapInputs) -> Raster:
    """Return a surface without the cells that a survey did not see, by its main beam if known, else by its points."""
    grid = inputs.grid
    if inputs.sightings is None:
        points = inputs.points if inputs.points.across_sigma_m is None else _over_strips(inputs)
        seen = seen_from_points(points, surface, grid, inputs.max_gap_m)
    else:
        seen = seen_cells(inputs.sightings, surface, grid, inputs.max_gap_m)
    return Raster(grid=grid, height_m=np.where(seen, _heights(surface, grid), np.nan))


def _over_strips(inputs: MapInputs) -> Points:
    """Return points at measured directions at places all over their footprints, as far as these are known."""
    points, footprints = inputs.points, inputs.footprints
    if footprints is None:
        return points
    count, spread = len(points), []
    for one, other in product(STRIP_PLACES, STRIP_PLACES):
        offset = one * footprints.footprint_m[:, 0] + other * footprints.footprint_m[:, 1]
        spread.append(points.position_m + np.column_stack([offset, np.zeros(count)]))
    many = points.rows(np.tile(np.arange(count), len(spread)))
    return replace(many, position_m=np.concatenate(spread))


def seen_from_points(points: Points, surface: Heightfield, grid: Grid, gap_m: float) -> Bool[np.ndarray, "row column"]:
    """Return the cells with points, and those between them in view from where the nearest point was seen."""
    illumination = Illumination(grid)
    illumination.add(points.position_m, points.origin_m)
    return _closed(illumination, surface, grid, gap_m)


def seen_cells(sightings: Sightings, surface: Heightfield, grid: Grid, gap_m: float) -> Bool[np.ndarray, "row column"]:
    """Return the cells that the main beam saw, from the measured poses over an estimated surface."""
    from sionna_radar.inference.echo.power_kernels import lit_cells

    illumination = Illumination(grid)
    beam = sightings.beam
    bright = beam.power >= LIT * beam.power.max()
    corner, weight = beam.corner[bright], beam.weight[bright]
    wanted = np.zeros(len(beam.direction), dtype=bool)
    wanted[corner] = True
    height, on = np.ascontiguousarray(surface.height_m), surface.grid
    cells = grid.west_m, grid.south_m, grid.spacing_m, grid.rows, grid.columns
    for low, high in chunks_of_bytes(len(sightings), 2 * 8 * len(corner)):
        block = np.zeros(len(sightings), dtype=bool)
        block[low:high] = True
        block_sightings = sightings.rows(block)
        position, direction = np.ascontiguousarray(block_sightings.pose.position_m), block_sightings.direction()
        range_m = footprints(block_sightings, surface, wanted).range_m
        found, pulse = np.empty((2, len(block_sightings) * len(corner)), dtype=np.int64)
        used = lit_cells(
            height, on.west_m, on.south_m, on.spacing_m, position, direction, range_m, corner, weight, OFF_SURFACE_M,
            cells, np.full(grid.rows * grid.columns, -1), found, pulse,
        )  # fmt: skip
        illumination.add_cells(found[:used], position[pulse[:used]])
    return _closed(illumination, surface, grid, gap_m)


def _closed(
    illumination: Illumination, surface: Heightfield, grid: Grid, gap_m: float
) -> Bool[np.ndarray, "row column"]:
    def visible(origin_m: Float[np.ndarray, "ray 3"], point_m: Float[np.ndarray, "ray 3"]) -> Bool[np.ndarray, " ray"]:
        away = point_m - origin_m
        distance = np.linalg.norm(away, axis=1)
        reached = surface.first_hit(origin_m, away / distance[:, None], float(distance.max()) + 1.0)
        return ~(reached < distance - VISIBLE_M)

    return illumination.mask(gap_m, Raster(grid=grid, height_m=_heights(surface, grid)), visible)


def _heights(surface: Heightfield, grid: Grid) -> Float[np.ndarray, "row column"]:
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    return surface.at(x.ravel(), y.ravel()).reshape(grid.shape)


def empty(grid: Grid) -> Raster:
    """Return an empty DEM."""
    return Raster(grid=grid, height_m=np.full(grid.shape, np.nan))
