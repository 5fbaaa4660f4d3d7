"""Triangle meshes of elevation rasters."""

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.threads import over_rows


def mesh_of(raster: Raster) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Return vertices and triangles of a raster: two triangles for every four filled neighbours.

        c---d
        | / |      counter-clockwise seen from above: a b d, a d c
        a---b

    Empty cells leave holes, and cells without a triangle have no vertex.
    """
    filled = raster.filled
    if filled.all():
        return _whole(raster)
    index = np.arange(raster.height_m.size).reshape(raster.grid.shape)
    corners = [index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]]
    whole = filled[:-1, :-1] & filled[:-1, 1:] & filled[1:, :-1] & filled[1:, 1:]
    faces = _two_triangles([corner[whole] for corner in corners])

    used = np.zeros(index.size, dtype=bool)
    used[faces] = True
    renumbered = np.cumsum(used) - 1
    vertices = np.column_stack([raster.grid.centres_m[used], raster.height_m.ravel()[used]])
    return vertices.astype(np.float64), renumbered[faces]


def _whole(raster: Raster) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Return vertices and triangles of a raster without empty cells: millions, so by compiled loops."""
    from sionna_radar.scene.mesh_kernels import triangles_of_rows, vertices_of_rows

    rows, columns = raster.grid.shape
    height = np.ascontiguousarray(raster.height_m, dtype=np.float64)
    vertices = np.empty((rows * columns, 3))
    faces = np.empty((2 * (rows - 1) * (columns - 1), 3), dtype=np.int32 if rows * columns < 2**31 else np.int64)
    place = raster.grid.x_m, raster.grid.y_m
    over_rows(lambda low, high: vertices_of_rows(low, high, *place, height, vertices), rows)
    over_rows(lambda low, high: triangles_of_rows(low, high, columns, faces), rows - 1)
    return vertices, faces


def _two_triangles(corners: list[Int[np.ndarray, "..."]]) -> Int[np.ndarray, "face 3"]:
    """Return two triangles for each square of corners a, b, c, d."""
    a, b, c, d = (corner.ravel() for corner in corners)
    faces = np.empty((len(a), 2, 3), dtype=np.int64)
    for place, corner in enumerate((a, b, d)):
        faces[:, 0, place] = corner
    for place, corner in enumerate((a, d, c)):
        faces[:, 1, place] = corner
    return faces.reshape(-1, 3)
