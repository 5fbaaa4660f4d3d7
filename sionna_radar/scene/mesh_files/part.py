"""Mesh parts as returned by all mesh readers: bounds, triangulation, index checks, and reading by trimesh.

Polygons of a mesh file are split into triangles, also concave ones, which trimesh splits as fans. Trimesh reads
unprocessed triangles, without merging vertices, and only from the given bytes.
"""

import io
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.errors import reason_of
from sionna_radar.foundation.input_file import shown

MAX_BYTES = 2_000_000_000
# Parsing text takes several times its size in memory.
MAX_TEXT_BYTES = 200_000_000
MAX_VERTICES = 20_000_000
MAX_FACES = 20_000_000
MAX_PARTS = 100_000


class MeshError(ValueError):
    """A defect of a mesh file with a remedy; the caller adds the file's name."""


@dataclass(frozen=True, kw_only=True)
class MeshPart:
    """The triangles of one material, in the file's own axes and units.

    name: the material's name, otherwise the object's; empty if the file names neither.
    """

    name: str
    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]


def check_count(count: int, most: int, what: str) -> None:
    """Raise MeshError if a count exceeds its limit."""
    if count > most:
        message = f"has {count:,} {what}, more than {most:,}; simplify the mesh, or cut out the part that is flown"
        raise MeshError(message)


def file_in_same_folder(path: Path, name: str, place: str) -> Path:
    """Resolve a file named by another one; it must lie in the same folder after resolving links.

    Raises MeshError, with the position of the name.
    """
    inner = Path(name.replace("\\", "/"))
    remedy = "a mesh may only name files of its own folder; put it there, or convert the mesh to one GLB file"
    if not name or "\0" in name or "://" in name or inner.is_absolute() or ".." in inner.parts or ":" in name[:3]:
        raise MeshError(f"{place} names {shown(name)}; {remedy}")
    try:
        folder, target = path.parent.resolve(), (path.parent / inner).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise MeshError(f"{place} names {shown(name)}, which cannot be reached; {remedy}") from error
    if not target.is_relative_to(folder):
        raise MeshError(f"{place} names {shown(name)}, a link to elsewhere; {remedy}")
    return target


def triangles_of(
    vertices: Float[np.ndarray, "vertex 3"], size: Int[np.ndarray, " polygon"], corner: Int[np.ndarray, " corner"]
) -> Int[np.ndarray, "face 3"]:
    """Return triangles of polygons, in their order and with their winding; polygons of fewer than 3 corners have none.

    vertices: positions of the corners.
    size: number of corners of each polygon.
    corner: the corners of all polygons, concatenated, as indices of vertices.

    Raises MeshError if an index is out of range, or there are too many triangles.
    """
    check_indices(corner, len(vertices))
    check_count(int(np.maximum(size - 2, 0).sum()), MAX_FACES, "triangles")
    if np.all(size == 3):
        return corner.reshape(-1, 3)
    start = np.cumsum(size) - size
    parts, order = [], []
    for sides, split in ((3, None), (4, _split_quads)):
        polygons = np.flatnonzero(size == sides)
        rows = corner[start[polygons, None] + np.arange(sides)]
        parts.append(rows if split is None else split(vertices, rows))
        order.append(np.repeat(polygons, sides - 2))
    for polygon in np.flatnonzero(size > 4):
        ring = corner[start[polygon] : start[polygon] + size[polygon]]
        triangles = _split_ring(vertices, ring)
        parts.append(triangles)
        order.append(np.full(len(triangles), polygon))
    faces = np.concatenate(parts)
    return faces[np.argsort(np.concatenate(order), kind="stable")]


def check_indices(index: Int[np.ndarray, "..."], count: int) -> None:
    """Raise MeshError, with their number, for indices out of range."""
    invalid = np.count_nonzero((index < 0) | (index >= count))
    if invalid:
        message = f"has {invalid:,} of {index.size:,} indices beyond its {count:,} vertices; export the mesh again"
        raise MeshError(message)


def _split_quads(vertices: Float[np.ndarray, "vertex 3"], quad: Int[np.ndarray, "n 4"]) -> Int[np.ndarray, "m 3"]:
    """Return two triangles for each quadrilateral, split along its inner diagonal."""
    a, b, c, d = np.moveaxis(vertices[quad], 1, 0)
    with np.errstate(invalid="ignore", over="ignore"):  # non-finite vertices are detected later
        folded = np.einsum("ni,ni->n", np.cross(b - a, c - a), np.cross(c - a, d - a)) < 0
    cut = np.where(folded[:, None], np.roll(quad, -1, axis=1), quad)
    return cut[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def _split_ring(vertices: Float[np.ndarray, "vertex 3"], ring: Int[np.ndarray, " n"]) -> Int[np.ndarray, "m 3"]:
    """Triangulate a polygon of any shape by ear clipping in the projection along its normal."""
    import mapbox_earcut

    fan = np.column_stack([np.full(len(ring) - 2, ring[0]), ring[1:-1], ring[2:]])
    points = vertices[ring]
    if not np.isfinite(points).all():
        return fan
    offsets = points - points[0]
    with np.errstate(over="ignore", invalid="ignore"):
        turn = np.cross(offsets[1:-1], offsets[2:])
        normal = turn.sum(axis=0)  # Newell's normal: twice the area of the polygon's shadow along each axis
        if np.all(turn @ normal >= 0) or not np.isfinite(normal).all():
            return fan
    axis = int(np.argmax(np.abs(normal)))
    plan = np.delete(offsets, axis, axis=1)
    cut = np.asarray(mapbox_earcut.triangulate_float64(plan, np.array([len(ring)], dtype=np.uint32)), dtype=np.int64)
    faces = ring[cut.reshape(-1, 3)]
    if len(faces) == 0:
        return fan
    corner = vertices[faces]
    area_vector = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).sum(axis=0)
    return faces if area_vector @ normal >= 0 else faces[:, ::-1]


def read_by_trimesh(data: bytes, kind: str, side_files: Mapping[str, bytes] | None = None) -> tuple[MeshPart, ...]:
    """Return the triangles of a file, one part for each mesh of each node.

    data: the whole file; what it claims must have been checked against its bytes.
    kind: its format in trimesh's notation.
    side_files: all other files available to trimesh, by name.

    Raises MeshError if it cannot be read.
    """
    import trimesh

    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", module=r"trimesh\.")
            warnings.simplefilter("ignore", RuntimeWarning)  # non-finite vertices are detected later
            scene = trimesh.load_scene(
                io.BytesIO(data),
                file_type=kind,
                resolver=dict(side_files or {}),  # no other file can be opened
                allow_remote=False,
                process=False,
            )
            return tuple(_parts(scene))
    except MeshError:
        raise
    except Exception as error:  # trimesh raises undocumented types
        reason = reason_of(error)
        raise MeshError(f"cannot be read as {kind.upper()} ({reason}); export it again") from error


def _parts(scene: Any) -> Iterator[MeshPart]:
    import trimesh

    vertex_count = face_count = 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh):  # points and lines
            continue
        vertex_count, face_count = vertex_count + len(mesh.vertices), face_count + len(mesh.faces)
        check_count(vertex_count, MAX_VERTICES, "vertices")
        check_count(face_count, MAX_FACES, "triangles")
        faces = np.array(mesh.faces, dtype=np.int64)
        check_indices(faces, len(mesh.vertices))
        if np.linalg.det(transform[:3, :3]) < 0:  # a mirrored copy
            faces = faces[:, ::-1]
        vertices = np.array(mesh.vertices, dtype=np.float64)
        if not np.array_equal(transform, np.eye(4)):
            vertices = vertices @ transform[:3, :3].T + transform[:3, 3]
        material = getattr(getattr(mesh.visual, "material", None), "name", None)
        yield MeshPart(name=str(material or mesh.metadata.get("name") or ""), vertices=vertices, faces=faces)
