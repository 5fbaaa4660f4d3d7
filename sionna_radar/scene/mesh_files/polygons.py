"""Splitting the polygons of a mesh file into triangles, also concave ones, which trimesh splits as fans."""

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.scene.mesh_files.part import MOST_FACES, MeshError, check_count


def triangles_of(
    vertices: Float[np.ndarray, "vertex 3"], size: Int[np.ndarray, " polygon"], corner: Int[np.ndarray, " corner"]
) -> Int[np.ndarray, "face 3"]:
    """Return triangles of polygons, in their order and with their winding; polygons of fewer than 3 corners have none.

    Parameters
    ----------
    vertices:
        Places of the corners.
    size:
        How many corners each polygon has.
    corner:
        The corners of all polygons, one polygon after the other, as indices of vertices.

    Raises
    ------
    MeshError
        An index is of no vertex, or there are too many triangles.

    """
    check_indices(corner, len(vertices))
    check_count(int(np.maximum(size - 2, 0).sum()), MOST_FACES, "triangles")
    if np.all(size == 3):
        return corner.reshape(-1, 3)
    start = np.cumsum(size) - size
    parts, order = [], []
    for sides, split in ((3, None), (4, _split_quads)):
        which = np.flatnonzero(size == sides)
        rows = corner[start[which, None] + np.arange(sides)]
        parts.append(rows if split is None else split(vertices, rows))
        order.append(np.repeat(which, sides - 2))
    for number in np.flatnonzero(size > 4):
        ring = corner[start[number] : start[number] + size[number]]
        found = _split_ring(vertices, ring)
        parts.append(found)
        order.append(np.full(len(found), number))
    faces = np.concatenate(parts)
    return faces[np.argsort(np.concatenate(order), kind="stable")]


def check_indices(index: Int[np.ndarray, "..."], count: int) -> None:
    """Raise MeshError, with how many there are, for indices of no vertex."""
    beyond = np.count_nonzero((index < 0) | (index >= count))
    if beyond:
        message = f"has {beyond:,} of {index.size:,} indices beyond its {count:,} vertices; export the mesh again"
        raise MeshError(message)


def _split_quads(vertices: Float[np.ndarray, "vertex 3"], quad: Int[np.ndarray, "n 4"]) -> Int[np.ndarray, "m 3"]:
    """Return two triangles for each quadrilateral, cut along the diagonal that lies inside it."""
    a, b, c, d = np.moveaxis(vertices[quad], 1, 0)
    with np.errstate(invalid="ignore", over="ignore"):  # vertices that are no places are found later
        folded = np.einsum("ni,ni->n", np.cross(b - a, c - a), np.cross(c - a, d - a)) < 0
    cut = np.where(folded[:, None], np.roll(quad, -1, axis=1), quad)
    return cut[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def _split_ring(vertices: Float[np.ndarray, "vertex 3"], ring: Int[np.ndarray, " n"]) -> Int[np.ndarray, "m 3"]:
    """Return triangles of a polygon of any shape, by cutting ears off it as seen along its normal."""
    import mapbox_earcut

    fan = np.column_stack([np.full(len(ring) - 2, ring[0]), ring[1:-1], ring[2:]])
    place = vertices[ring]
    if not np.isfinite(place).all():
        return fan
    away = place - place[0]
    with np.errstate(over="ignore", invalid="ignore"):
        turn = np.cross(away[1:-1], away[2:])
        normal = turn.sum(axis=0)  # Newell's normal: twice the area of the polygon's shadow along each axis
        if np.all(turn @ normal >= 0) or not np.isfinite(normal).all():
            return fan
    axis = int(np.argmax(np.abs(normal)))
    plan = np.delete(away, axis, axis=1)
    cut = np.asarray(mapbox_earcut.triangulate_float64(plan, np.array([len(ring)], dtype=np.uint32)), dtype=np.int64)
    faces = ring[cut.reshape(-1, 3)]
    if len(faces) == 0:
        return fan
    corner = vertices[faces]
    found = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).sum(axis=0)
    return faces if found @ normal >= 0 else faces[:, ::-1]
