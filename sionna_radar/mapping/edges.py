"""Which places lie so near a wall that the beam on them lights more than one level."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from sionna_radar.mapping.points import Points
from sionna_radar.raster import Grid
from sionna_radar.scenario.objects import Building


def half_footprint_m(points: Points, beamwidth_rad: float) -> Float[np.ndarray, " point"]:
    """Return half the longer side of the footprint that each point's beam has on level ground."""
    down = (points.origin_m[:, 2] - points.position_m[:, 2]) / points.range_m
    return points.range_m * beamwidth_rad / 2 / np.maximum(down, 1e-3)


def edge_cells(
    grid: Grid, points: Points, beamwidth_rad: float, buildings: Sequence[Building]
) -> Bool[np.ndarray, "row column"]:
    """Tell which cells lie within half a footprint of a wall; each has the footprint of the point next to it."""
    if len(points) == 0 or not buildings:
        return np.zeros(grid.shape, dtype=bool)
    nearest = KDTree(points.position_m[:, :2]).query(grid.centres_m)[1]
    reach_m = half_footprint_m(points, beamwidth_rad)[nearest]
    return near_walls(grid.centres_m, reach_m, buildings).reshape(grid.shape)


def near_walls(
    place_m: Float[np.ndarray, "n 2"], reach_m: Float[np.ndarray, " n"], buildings: Sequence[Building]
) -> Bool[np.ndarray, " n"]:
    """Tell which places of the plan lie within reach of a building's outline, inside it or outside."""
    near = np.zeros(len(place_m), dtype=bool)
    for building in buildings:
        near |= np.abs(_outside(place_m, building)) <= reach_m
    return near


def _outside(place_m: Float[np.ndarray, "n 2"], building: Building) -> Float[np.ndarray, " n"]:
    """Return the distance to a building's outline, negative inside it."""
    heading = np.deg2rad(building.heading_deg)
    offset = place_m - np.array(building.position_m)
    along = offset @ np.array([np.sin(heading), np.cos(heading)])
    across = offset @ np.array([np.cos(heading), -np.sin(heading)])
    beyond = np.abs(np.column_stack([along, across])) - np.array(building.size_m[:2]) / 2
    distance: Float[np.ndarray, " n"] = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return distance + np.minimum(beyond.max(axis=1), 0.0)
