"""From points to a DEM: linear interpolation in their Delaunay triangles, empty where nothing was seen.

Left empty are cells farther than `max_gap_m` from every point, cells in triangles with a side longer than a few such
gaps (they close the bays of the outline, where nothing was seen), and cells in triangles across a radar shadow.
Such a triangle extends from an occluding edge to the ground behind it, parallel to the rays that passed the
edge: seen from the radar it is edge-on. Left empty too are cells in triangles between the foot and the top of a wall
(`wall_triangles`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, KDTree, QhullError

from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.wall_triangles import wall_triangles

LONGEST_SIDE_GAPS = 3.0
# Triangles whose shadows are looked for at once: it bounds the memory.
AT_ONCE = 50_000


@dataclass(frozen=True)
class Interpolated:
    """A DEM of linear interpolation, and from which points each cell was made.

    cell: filled cells, by their numbers in the grid; corner: the three points around each; share: their weights.
    """

    dem: Raster
    cell: Int[np.ndarray, " filled"]
    corner: Int[np.ndarray, "filled 3"]
    share: Float[np.ndarray, "filled 3"]


def grid_points(points: Points, grid: Grid, max_gap_m: float, shadow_incidence_rad: float) -> Interpolated:
    """Interpolate points to a grid.

    Parameters
    ----------
    points:
        Located echoes; of several at one horizontal position the highest counts.
    grid:
        Grid of the DEM.
    max_gap_m:
        Largest distance of a filled cell from a point.
    shadow_incidence_rad:
        A triangle wider than the gap and seen by the radar at a greater incidence is a shadow.

    """
    height = np.full(grid.rows * grid.columns, np.nan)
    highest = _highest(points)
    place, z, origin = points.position_m[highest, :2], points.position_m[highest, 2], points.origin_m[highest]
    try:
        simplices = Delaunay(place).simplices
    except (QhullError, ValueError):  # too few points, or all on one line
        nothing = np.zeros((0, 3))
        return Interpolated(
            Raster(grid=grid, height_m=height.reshape(grid.shape)),
            np.zeros(0, dtype=np.int64),
            nothing.astype(np.int64),
            nothing,
        )
    some = (simplices[first : first + AT_ONCE] for first in range(0, len(simplices), AT_ONCE))
    kept = np.concatenate([_lit(each, place, z, origin, max_gap_m, shadow_incidence_rad) for each in some])
    on_triangles = np.column_stack([place, z]), points.range_sigma_m[highest], simplices
    kept &= ~wall_triangles(*on_triangles, max_gap_m, grid.spacing_m)
    inside = _triangle_of_cells(place, simplices, kept, grid)
    cell = grid.centres_m
    use = inside >= 0
    use[use] = KDTree(place).query(cell[use], distance_upper_bound=max_gap_m)[0] <= max_gap_m
    corners = simplices[inside[use]]
    share = _barycentric(place[corners], cell[use])
    height[use] = np.einsum("ck,ck->c", share, z[corners])
    dem = Raster(grid=grid, height_m=height.reshape(grid.shape))
    return Interpolated(dem, np.flatnonzero(use), highest[corners], share)


def _triangle_of_cells(
    place: Float[np.ndarray, "n 2"],
    simplices: Int[np.ndarray, "triangle 3"],
    wanted: Bool[np.ndarray, " triangle"],
    grid: Grid,
) -> Int[np.ndarray, " cell"]:
    """Return the wanted triangle that each cell lies in; -1 for none."""
    # Numba takes half a second to import.
    from sionna_radar.mapping.triangle_kernels import fill_triangles

    inside = np.full(grid.shape, -1, dtype=np.int64)
    fill_triangles(place, simplices, wanted, (grid.west_m, grid.south_m), grid.spacing_m, inside)
    return inside.ravel()


def _highest(points: Points) -> Int[np.ndarray, " n"]:
    """Return the highest of the points at each horizontal position."""
    order = np.lexsort((-points.position_m[:, 2], points.position_m[:, 1], points.position_m[:, 0]))
    place = points.position_m[order, :2]
    new = np.ones(len(place), dtype=bool)
    new[1:] = np.any(place[1:] != place[:-1], axis=1)
    return np.asarray(order[new])


def _lit(
    simplices: Int[np.ndarray, "triangle 3"],
    place: Float[np.ndarray, "n 2"],
    z: Float[np.ndarray, " n"],
    origin: Float[np.ndarray, "n 3"],
    gap_m: float,
    incidence_rad: float,
) -> Bool[np.ndarray, " triangle"]:
    corner = np.column_stack([place, z])[simplices]
    side = np.roll(corner, -1, axis=1) - corner
    normal = np.cross(side[:, 0], side[:, 1])
    normal *= np.sign(normal[:, 2:])
    to_radar = origin[simplices].mean(axis=1) - corner.mean(axis=1)
    cos = np.einsum("ti,ti->t", normal, to_radar)
    cos /= np.maximum(np.linalg.norm(normal, axis=1) * np.linalg.norm(to_radar, axis=1), 1e-30)
    longest = np.linalg.norm(side, axis=2).max(axis=1)
    on_plan = np.linalg.norm(side[:, :, :2], axis=2).max(axis=1)
    shadow = (cos < np.cos(incidence_rad)) & (longest > gap_m)
    return ~shadow & (on_plan <= LONGEST_SIDE_GAPS * gap_m)


def _barycentric(
    corner: Float[np.ndarray, "cell 3 2"], cell: Float[np.ndarray, "cell 2"]
) -> Float[np.ndarray, "cell 3"]:
    """Return the weights of the corners of triangles at cells."""
    from_first = cell - corner[:, 0]
    b, c = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
    weight_b = (from_first[:, 0] * c[:, 1] - from_first[:, 1] * c[:, 0]) / area
    weight_c = (b[:, 0] * from_first[:, 1] - b[:, 1] * from_first[:, 0]) / area
    return np.column_stack([1 - weight_b - weight_c, weight_b, weight_c])
