"""Masks of places within half a beam footprint of a wall, and wall distances."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.points import Points
from sionna_radar.scene.footprints import Box
from sionna_radar.scene.model import Scene, Surface

# Loose soil is no steeper than about 40 deg; a face that exceeds both limits is a wall.
WALL_SLOPE_DEG = 60.0
WALL_HEIGHT_M = 1.0
# Sample points along a wall, per cell length of the map.
FOOT_POINTS_PER_CELL = 2


@dataclass(frozen=True, kw_only=True)
class Walls:
    """The walls of a scene in plan view.

    buildings: boxes of the scenario, whose outlines are known exactly.
    foot_m: points on edges of steep faces of other surfaces.
    """

    buildings: tuple[Box, ...]
    foot_m: Float[np.ndarray, "point 2"]

    def __bool__(self) -> bool:
        return bool(self.buildings) or len(self.foot_m) > 0

    def near(self, place_m: Float[np.ndarray, "n 2"], reach_m: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Return the mask of places within `reach_m` of a wall, on either side."""
        near = near_buildings(place_m, reach_m, self.buildings)
        if len(self.foot_m):
            near |= KDTree(self.foot_m).query(place_m, distance_upper_bound=float(reach_m.max()) + 1e-6)[0] <= reach_m
        return near

    def distance_m(self, place_m: Float[np.ndarray, "n 2"], farthest_m: float) -> Float[np.ndarray, " n"]:
        """Return the distance to the nearest wall, in front of it or behind, m; infinite beyond `farthest_m`."""
        distance = np.full(len(place_m), np.inf)
        for building in self.buildings:
            distance = np.minimum(distance, np.abs(_signed_distance_m(place_m, building)))
        if len(self.foot_m):
            foot = KDTree(self.foot_m).query(place_m, distance_upper_bound=farthest_m + 1e-6)[0]
            distance = np.minimum(distance, foot)
        return np.where(distance <= farthest_m, distance, np.inf)


def walls_on(grid: Grid, scene: Scene, buildings: Sequence[Box]) -> Walls:
    """Return a scene's walls on a map; its last surfaces must be `buildings`."""
    others = scene.surfaces[: len(scene.surfaces) - len(buildings)]
    feet = [_foot_points(surface, grid) for surface in others]
    return Walls(buildings=tuple(buildings), foot_m=np.concatenate([np.zeros((0, 2)), *feet]))


def half_footprint_m(points: Points, beamwidth_rad: float) -> Float[np.ndarray, " point"]:
    """Return each point's footprint semi-major axis on level ground, m."""
    down = (points.origin_m[:, 2] - points.position_m[:, 2]) / points.range_m
    return points.range_m * beamwidth_rad / 2 / np.maximum(down, 1e-3)


def edge_cells(grid: Grid, points: Points, beamwidth_rad: float, walls: Walls) -> Bool[np.ndarray, "row column"]:
    """Return the mask of cells closer to a wall than half the footprint of the nearest point."""
    if len(points) == 0 or not walls:
        return np.zeros(grid.shape, dtype=bool)
    nearest = KDTree(points.position_m[:, :2]).query(grid.centres_m)[1]
    reach_m = half_footprint_m(points, beamwidth_rad)[nearest]
    return walls.near(grid.centres_m, reach_m).reshape(grid.shape)


def near_buildings(
    place_m: Float[np.ndarray, "n 2"], reach_m: Float[np.ndarray, " n"], buildings: Sequence[Box]
) -> Bool[np.ndarray, " n"]:
    """Return the mask of places within reach of a building's outline, inside it or outside."""
    near = np.zeros(len(place_m), dtype=bool)
    for building in buildings:
        near |= np.abs(_signed_distance_m(place_m, building)) <= reach_m
    return near


def _signed_distance_m(place_m: Float[np.ndarray, "n 2"], building: Box) -> Float[np.ndarray, " n"]:
    """Return the distance to a building's outline, negative inside it."""
    heading = building.heading_rad
    offset = place_m - np.array(building.position_m)
    along = offset @ np.array([np.sin(heading), np.cos(heading)])
    across = offset @ np.array([np.cos(heading), -np.sin(heading)])
    beyond = np.abs(np.column_stack([along, across])) - np.array(building.size_m[:2]) / 2
    distance: Float[np.ndarray, " n"] = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return distance + np.minimum(beyond.max(axis=1), 0.0)


def _foot_points(surface: Surface, grid: Grid) -> Float[np.ndarray, "point 2"]:
    """Return horizontal positions along the edges of a surface's steep faces within a map."""
    west, east, south, north = grid.extent_m
    least_m = 0.0 if surface.divided else WALL_HEIGHT_M
    height_m = surface.vertices_m[:, 2][surface.faces]
    corner = surface.vertices_m[surface.faces[np.ptp(height_m, axis=1) >= least_m]]
    low, high = corner[..., :2].min(axis=1), corner[..., :2].max(axis=1)
    corner = corner[np.all((high >= [west, south]) & (low <= [east, north]), axis=1)]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    # Faces without an area count as steep.
    corner = corner[~(np.abs(normal[:, 2]) >= np.cos(np.deg2rad(WALL_SLOPE_DEG)) * np.linalg.norm(normal, axis=1))]
    if surface.divided:
        corner = corner[_height_of_walls(corner, grid.spacing_m) >= WALL_HEIGHT_M]
    start = corner[..., :2].reshape(-1, 2)
    edge = np.roll(corner[..., :2], -1, axis=1).reshape(-1, 2) - start
    step_m = grid.spacing_m / FOOT_POINTS_PER_CELL
    pieces = np.ceil(np.linalg.norm(edge, axis=1) / step_m).astype(int) + 1
    number = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    share = number / np.repeat(np.maximum(pieces - 1, 1), pieces)
    point = np.repeat(start, pieces, axis=0) + share[:, None] * np.repeat(edge, pieces, axis=0)
    on_map = np.all((point >= [west, south]) & (point <= [east, north]), axis=1)
    # Duplicates: triangles share edges, and a wall's coincide in plan.
    return np.unique(np.round(point[on_map] / step_m * 4).astype(np.int64), axis=0) * step_m / 4


def _height_of_walls(corner: Float[np.ndarray, "face 3 3"], spacing_m: float) -> Float[np.ndarray, " face"]:
    """Return for each face the height range of all faces in its map cell, since a wall may have many."""
    cell = np.floor(corner[..., :2].mean(axis=1) / spacing_m).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_inverse=True)
    number = number.ravel()
    low, high = np.full(len(corner), np.inf), np.full(len(corner), -np.inf)
    np.minimum.at(low, number, corner[..., 2].min(axis=1))
    np.maximum.at(high, number, corner[..., 2].max(axis=1))
    return (high - low)[number]
