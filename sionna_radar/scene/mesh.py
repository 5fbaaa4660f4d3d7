"""Triangle meshes of elevation rasters."""

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.raster import Raster


def mesh_of(raster: Raster) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Return vertices and triangles of a raster: two triangles for every four filled neighbours.

        c---d
        | / |      counter-clockwise seen from above: a b d, a d c
        a---b

    Empty cells leave holes, and cells without a triangle have no vertex.
    """
    index = np.arange(raster.height_m.size).reshape(raster.grid.shape)
    corners = [index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]]
    filled = raster.filled
    if filled.all():
        return np.column_stack([raster.grid.centres_m, raster.height_m.ravel()]), _two_triangles(corners)
    whole = filled[:-1, :-1] & filled[:-1, 1:] & filled[1:, :-1] & filled[1:, 1:]
    faces = _two_triangles([corner[whole] for corner in corners])

    used = np.zeros(index.size, dtype=bool)
    used[faces] = True
    renumbered = np.cumsum(used) - 1
    vertices = np.column_stack([raster.grid.centres_m[used], raster.height_m.ravel()[used]])
    return vertices.astype(np.float64), renumbered[faces]


def _two_triangles(corners: list[Int[np.ndarray, "..."]]) -> Int[np.ndarray, "face 3"]:
    """Return two triangles for each square of corners a, b, c, d."""
    a, b, c, d = (corner.ravel() for corner in corners)
    faces = np.empty((len(a), 2, 3), dtype=np.int64)
    for place, corner in enumerate((a, b, d)):
        faces[:, 0, place] = corner
    for place, corner in enumerate((a, d, c)):
        faces[:, 1, place] = corner
    return faces.reshape(-1, 3)
