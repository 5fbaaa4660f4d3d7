"""Mappable ground of a survey: cells in the main beam and not in geometric shadow.

Masks of places within half a beam footprint of a wall, and wall distances.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.mapping.coverage import Illumination
from sionna_radar.mapping.points import Points
from sionna_radar.radar.antenna import LIT, Antenna, in_main_lobe, voltage_at
from sionna_radar.scene.footprints import Box
from sionna_radar.scene.model import Scene, Surface
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.paths import Paths


def main_beam_hits(
    paths: Paths, pulses: Pulses, antenna: Antenna, beams: Sequence[Antenna] = ()
) -> tuple[Float[np.ndarray, "hit 3"], Float[np.ndarray, "hit 3"]]:
    """Return the surface hits of a block's paths inside the main beam, and the true radar positions.

    beams: of an electronic scan, each with its own pattern.
    """
    pose = pulses.true
    start = np.searchsorted(paths.pulse, np.append(pulses.index, pulses.index[-1] + 1))
    direction = np.empty((len(paths), 3))
    ahead(start, pose.position_m, np.ascontiguousarray(pose.R_world_antenna), paths.hit_m, direction)
    row = np.repeat(np.arange(len(pulses)), np.diff(start))
    in_lobe = paths.surface >= 0
    if beams and pulses.beam is not None:
        beam = pulses.beam[row]
        for number in np.unique(beam):
            hits = np.flatnonzero(beam == number)
            in_lobe[hits] &= in_main_lobe(beams[int(number)], direction[hits])
    else:
        in_lobe &= in_main_lobe(antenna, direction)
    return paths.hit_m[in_lobe], pose.position_m[row[in_lobe]]


def light(paths: Paths, pulses: Pulses, antenna: Antenna, beams: Sequence[Antenna], lit: Illumination) -> None:
    """Mark the cells below the hits of `main_beam_hits`; for a separable antenna in one pass."""
    if not antenna.separable or (beams and pulses.beam is not None):
        lit.add(*main_beam_hits(paths, pulses, antenna, beams))
        return

    pose = pulses.true
    start = np.searchsorted(paths.pulse, np.append(pulses.index, pulses.index[-1] + 1))
    lobe = (*(np.ascontiguousarray(cut.voltage) for cut in (antenna.azimuth, antenna.elevation)), LIT)
    # In the precision of the hits, as NumPy promotes Python numbers.
    grid = (paths.hit_m.dtype.type(number) for number in (lit.grid.west_m, lit.grid.south_m, lit.grid.spacing_m))
    axes, surface = np.ascontiguousarray(pose.R_world_antenna), paths.surface.astype(np.int64, copy=False)
    light_cells(start, pose.position_m, axes, paths.hit_m, surface, lobe, tuple(grid), *lit.columns)


@compiled
@no_type_check
def ahead(first, position, axes, hit, out):
    """Write the unit vectors from the antennas to hits, in the antennas' frames.

    first: index of each pulse's first hit, plus the overall end.
    """
    for pulse in range(len(position)):
        for n in range(first[pulse], first[pulse + 1]):
            x, y, z = hit[n, 0] - position[pulse, 0], hit[n, 1] - position[pulse, 1], hit[n, 2] - position[pulse, 2]
            distance = np.sqrt(x * x + y * y + z * z)
            for k in range(3):
                out[n, k] = (x * axes[pulse, 0, k] + y * axes[pulse, 1, k] + z * axes[pulse, 2, k]) / distance


@compiled
@no_type_check
def light_cells(first, position, axes, hit, surface, lobe, grid, origin, seen):
    """Mark the cells of a grid under hits on surfaces inside the main lobe of a separable antenna.

    lobe: the cuts in azimuth and elevation, and the minimum two-way power over the peak's.
    grid: centre of its south-western cell, and the spacing, in the precision of the hits.
    origin, seen: radar position of each cell's last hit, and the mask of hit cells; both are written.
    """
    azimuth, elevation, level = lobe
    west, south, spacing = grid
    rows, columns = seen.shape
    for pulse in range(len(position)):
        px, py, pz = position[pulse, 0], position[pulse, 1], position[pulse, 2]
        for n in range(first[pulse], first[pulse + 1]):
            if surface[n] < 0:
                continue
            x, y, z = hit[n, 0] - px, hit[n, 1] - py, hit[n, 2] - pz
            distance = np.sqrt(x * x + y * y + z * z)
            ahead = (x * axes[pulse, 0, 0] + y * axes[pulse, 1, 0] + z * axes[pulse, 2, 0]) / distance
            left = (x * axes[pulse, 0, 1] + y * axes[pulse, 1, 1] + z * axes[pulse, 2, 1]) / distance
            up = (x * axes[pulse, 0, 2] + y * axes[pulse, 1, 2] + z * axes[pulse, 2, 2]) / distance
            voltage = voltage_at(azimuth, left) * voltage_at(elevation, up)
            gain = voltage * voltage * max(ahead, 0.0)
            if not gain * gain >= level:
                continue
            column, row = np.rint((hit[n, 0] - west) / spacing), np.rint((hit[n, 1] - south) / spacing)
            if 0 <= row < rows and 0 <= column < columns:
                i, j = int(row), int(column)
                seen[i, j] = True
                origin[i, j, 0], origin[i, j, 1], origin[i, j, 2] = px, py, pz


TOLERANCE_M = 0.05


def shadowed(
    truth: Raster,
    caster: RayCaster,
    track_m: Float[np.ndarray, "2 3"],
    incidence_rad: float,
    half_swath_rad: float,
) -> Bool[np.ndarray, "row column"]:
    """Return the mask of true-surface cells in radar shadow: scanned by a whisk-broom but not visible from the track.

    The angle between beam and track is the complement of the incidence. A cell that is y across and z below the
    track is therefore scanned from the place x = tan(incidence) hypot(y, z) short of it, and only from there.

    Parameters
    ----------
    truth, caster:
        The true surface as a raster, and rays against it.
    track_m:
        Start and end of a straight, level flight.
    incidence_rad, half_swath_rad:
        The scan.

    Returns
    -------
    Mask of the cells in radar shadow.
    """
    start, end = track_m
    length = float(np.linalg.norm(end - start))
    ahead = (end - start) / length
    cell = np.column_stack([truth.grid.centres_m, truth.height_m.ravel()])
    cell[:, 2] = np.where(np.isfinite(cell[:, 2]), cell[:, 2], 0.0)
    offset = cell - start
    across = offset[:, 0] * ahead[1] - offset[:, 1] * ahead[0]
    below = -offset[:, 2]
    along = offset @ ahead - np.tan(incidence_rad) * np.hypot(across, below)
    scanned = (along >= 0) & (along <= length) & (np.abs(np.arctan2(across, below)) <= half_swath_rad)
    scanned &= truth.filled.ravel()
    visible = caster.visible(start + along[:, None] * ahead, cell, TOLERANCE_M)
    return (scanned & ~visible).reshape(truth.grid.shape)


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


def raster_walls(
    height_m: Float[np.ndarray, "row column"],
    place: Callable[[Int[np.ndarray, " n"], Int[np.ndarray, " n"]], Float[np.ndarray, "n 2"]],
) -> Walls:
    """Return the walls of a raster: the middles of steps between neighbouring cells, as high and steep as in meshes.

    place: returns the positions of cells by row and column, m.
    """
    feet = [np.zeros((0, 2))]
    for axis in (0, 1):
        row, column = np.nonzero(np.abs(np.diff(height_m, axis=axis)) >= WALL_HEIGHT_M)
        beyond = row + (axis == 0), column + (axis == 1)
        here, there = place(row, column), place(*beyond)
        rise_m, run_m = np.abs(height_m[beyond] - height_m[row, column]), np.linalg.norm(there - here, axis=1)
        feet.append(((here + there) / 2)[rise_m >= run_m * np.tan(np.deg2rad(WALL_SLOPE_DEG))])
    return Walls(buildings=(), foot_m=np.concatenate(feet))


def half_footprint_m(points: Points, beamwidth_rad: float) -> Float[np.ndarray, " point"]:
    """Return each point's footprint semi-major axis on level ground, m.

    Parameters
    ----------
    points:
        Located echoes.
    beamwidth_rad:
        Half-power beamwidth, rad.

    Returns
    -------
    Semi-major axis of each footprint, m.
    """
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
    """Return the mask of places within reach of a building's outline, inside it or outside.

    Parameters
    ----------
    place_m:
        Horizontal positions, m.
    reach_m:
        Distance of each position within which a building counts as near, m.
    buildings:
        Boxes of the buildings.

    Returns
    -------
    Mask of the positions within reach of an outline, or inside it.
    """
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
    # Corner by corner: NumPy reduces three long arrays ten times as fast as many triples.
    height_m = [surface.vertices_m[corner, 2] for corner in surface.faces.T]
    range_m = np.maximum.reduce(height_m) - np.minimum.reduce(height_m)
    corner = surface.vertices_m[surface.faces[range_m >= least_m]]
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
    fraction = number / np.repeat(np.maximum(pieces - 1, 1), pieces)
    point = np.repeat(start, pieces, axis=0) + fraction[:, None] * np.repeat(edge, pieces, axis=0)
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
