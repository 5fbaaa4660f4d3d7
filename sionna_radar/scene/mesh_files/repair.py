"""Repair of imported meshes: degenerate and duplicate faces are removed, and faces oriented outward.

All materials of a mesh are repaired together, since one object may have several.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.scene.mesh_files.part import MeshPart

logger = logging.getLogger("sionna_radar")

# Merge tolerance of vertices, relative to the mesh's size: float32 and text files round one position differently.
SAME_PLACE = 1e-6
# Above this number, vertices are merged only within cells of that size, not across cell borders.
MAX_JOINED = 3_000_000
# Area vectors of a closed surface cancel. A larger residual, relative to the total area, indicates a sheet.
SHEET_FRACTION = 0.5
# Sheets face down if their net downward area exceeds this fraction.
DOWNWARD_FRACTION = 0.1
# Thinner faces are degenerate for a float32 ray tracer a few metres away.
THINNEST_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class RepairedMesh:
    """A mesh without degenerate faces, counter-clockwise seen from outside.

    owner: the part of each face.
    two_sided: faces of open surfaces, whose two sides are both outside.
    """

    vertices_m: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    owner: Int[np.ndarray, " face"]
    two_sided: Bool[np.ndarray, " face"]


def repair(parts: Sequence[MeshPart], name: str) -> RepairedMesh:
    """Repair a mesh in metres with z up, and log the number of repairs by kind.

    parts: the mesh, in metres.
    name: the key and the file, for messages.

    Raises InputFileError if no valid face remains.
    """
    vertex_start = np.cumsum([0, *(len(p.vertices) for p in parts)])
    vertices = np.concatenate([p.vertices for p in parts])
    faces = np.concatenate([p.faces + f for p, f in zip(parts, vertex_start, strict=False)])
    owner = np.repeat(np.arange(len(parts)), [len(p.faces) for p in parts])
    counts: dict[str, int] = {}

    usable = np.isfinite(vertices[faces]).all(axis=(1, 2))
    counts["faces with a vertex that is no place"] = int(np.count_nonzero(~usable))
    faces, owner = faces[usable], owner[usable]
    has_area = _width(vertices[faces]) > THINNEST_M
    counts["faces without an area"] = int(np.count_nonzero(~has_area))
    faces, owner = faces[has_area], owner[has_area]
    if len(faces) == 0:
        raise InputFileError(
            f"{name}: none of its {len(usable):,} faces is a surface ({_count_text(counts)}); export the mesh again"
        )
    merged = _merged(vertices, faces)
    single = _unique_faces(merged)
    counts["faces that are there twice"] = len(faces) - len(single)
    faces, owner, merged = faces[single], owner[single], merged[single]
    flip, closed = _outward(vertices, faces, merged)
    counts["faces with reversed winding"] = int(np.count_nonzero(flip))
    faces[flip] = faces[flip][:, ::-1]
    if any(counts.values()):
        logger.warning("%s: repaired %s, of %s faces", name, _count_text(counts), f"{len(usable):,}")
    return RepairedMesh(vertices_m=vertices, faces=faces, owner=owner, two_sided=~closed)


def _count_text(counts: dict[str, int]) -> str:
    return ", ".join(f"{count:,} {what}" for what, count in counts.items() if count)


def _width(corner: Float[np.ndarray, "face 3 3"]) -> Float[np.ndarray, " face"]:
    """Return the height of each triangle over its longest side."""
    side = corner - np.roll(corner, 1, axis=1)
    longest = np.sqrt(np.einsum("fki,fki->fk", side, side).max(axis=1, initial=0.0))
    twice_area = np.linalg.norm(np.cross(side[:, 0], side[:, 1]), axis=1)
    return twice_area / np.maximum(longest, 1e-300)


def _merged(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> Int[np.ndarray, "face 3"]:
    """Return faces with one index for all vertices at the same position."""
    referenced = np.zeros(len(vertices), dtype=bool)
    referenced[faces] = True
    position = vertices[referenced] - vertices[referenced].min(axis=0)
    tolerance = position.max() * SAME_PLACE
    east, north, height = np.round(position / tolerance).astype(np.int64).T
    # Each of the three is below 2^20.
    _, first_vertex, cell = np.unique((east << 40) | (north << 20) | height, return_index=True, return_inverse=True)
    merged_index = np.zeros(len(vertices), dtype=np.int64)
    merged_index[referenced] = _cluster_labels(position[first_vertex], tolerance)[cell]
    return merged_index[faces]


def _cluster_labels(position: Float[np.ndarray, "n 3"], reach: float) -> Int[np.ndarray, " n"]:
    """Return one label per cluster of positions within reach, across cell borders."""
    if len(position) > MAX_JOINED:
        return np.arange(len(position))
    first, second = KDTree(position).query_pairs(reach / 2, output_type="ndarray").T
    graph = coo_array((np.ones(len(first), dtype=bool), (first, second)), shape=(len(position), len(position)))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _unique_faces(faces: Int[np.ndarray, "face 3"]) -> Int[np.ndarray, " single"]:
    """Return the rows of faces, in order, without duplicates of the same corners."""
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)
    unique = np.ones(len(faces), dtype=bool)
    unique[order[1:]] = np.any(corners[order[1:]] != corners[order[:-1]], axis=1)
    return np.flatnonzero(unique)


def _outward(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], merged: Int[np.ndarray, "face 3"]
) -> tuple[Bool[np.ndarray, " face"], Bool[np.ndarray, " face"]]:
    """Return masks of the faces to turn, and of the faces of closed surfaces.

    Neighbours are oriented consistently, by the majority of the area. Solids, possibly with gaps, then enclose a
    positive volume; sheets keep their orientation, unless all of them together face down more than up.
    """
    count = len(faces)
    first, second, agree, paired = _neighbours(merged)
    # Two nodes per face, as is and flipped; consistent orientations of neighbours are connected.
    start = np.concatenate([first, first + count])
    end = np.concatenate([np.where(agree, second, second + count), np.where(agree, second + count, second)])
    graph = coo_array((np.ones(len(start), dtype=bool), (start, end)), shape=(2 * count, 2 * count))
    label = connected_components(graph, directed=False)[1]
    as_is, turned = label[:count], label[count:]
    sided = as_is != turned  # a one-sided surface, like a Moebius strip, is left unchanged
    _, piece = np.unique(np.minimum(as_is, turned), return_inverse=True)
    flip = sided & (turned < as_is)
    area_m2 = _areas(vertices[faces])
    size = np.linalg.norm(area_m2, axis=1)
    flip ^= sided & (np.bincount(piece, size * np.where(flip, 1, -1)) > 0)[piece]
    closed = sided & (np.bincount(piece, ~paired.all(axis=1)) == 0)[piece]

    area_m2[flip] *= -1
    area_sum_m2 = np.column_stack([np.bincount(piece, area_m2[:, axis]) for axis in range(3)])
    solid = sided & (np.linalg.norm(area_sum_m2, axis=1) < SHEET_FRACTION * np.bincount(piece, size))[piece]
    inverted = solid & (_volumes(vertices[faces].mean(axis=1), area_m2, piece) < 0)[piece]
    sheet = sided & ~solid
    if np.sum(area_m2[sheet, 2]) < -DOWNWARD_FRACTION * np.sum(size[sheet]):
        inverted |= sheet
    return flip ^ inverted, closed


def _areas(corner: Float[np.ndarray, "face 3 3"]) -> Float[np.ndarray, "face 3"]:
    """Return the area of each face along its normal."""
    return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) / 2


def _volumes(
    centre: Float[np.ndarray, "face 3"], area_m2: Float[np.ndarray, "face 3"], piece: Int[np.ndarray, " face"]
) -> Float[np.ndarray, " piece"]:
    """Return three times the volume enclosed by each piece, with gaps closed by cones from its middle."""
    size = np.linalg.norm(area_m2, axis=1)
    total = np.bincount(piece, size)
    middle = np.column_stack([np.bincount(piece, size * centre[:, axis]) / total for axis in range(3)])
    return np.bincount(piece, np.einsum("fi,fi->f", centre - middle[piece], area_m2))


def _neighbours(
    faces: Int[np.ndarray, "face 3"],
) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"], Bool[np.ndarray, " pair"], Bool[np.ndarray, "face 3"]]:
    """Return pairs of faces that alone share a side, whether their orientations agree, and the mask of shared sides."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = np.minimum(start, end) * (int(faces.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    begins = np.flatnonzero(np.diff(key[order], prepend=-1))
    length = np.diff(begins, append=len(key))
    pair_start = begins[length == 2]
    first_side, second_side = order[pair_start], order[pair_start + 1]
    paired = np.zeros(len(key), dtype=bool)
    paired[first_side] = paired[second_side] = True
    forward = start < end
    return first_side // 3, second_side // 3, forward[first_side] != forward[second_side], paired.reshape(-1, 3)
