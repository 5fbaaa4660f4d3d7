"""Repairing meshes as they come from the world: what is no surface goes, and every facet shows its outside.

Whole meshes are repaired at once, all of their materials together, for one object may be of several.
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

# Vertices nearer than this share of the mesh's size are one: float32 and text files write one place in several ways.
SAME_PLACE = 1e-6
# Larger meshes are joined by cells of that size alone, across whose borders two ways to write one place stay two.
MAX_JOINED = 3_000_000
# The areas of a closed surface cancel. If this share of them is left, it is a sheet, and not a solid with gaps.
SHEET_SHARE = 0.5
# Sheets look down if this share of their area does, in sum.
DOWNWARD_SHARE = 0.1
# A facet thinner than this is a line to a float32 ray tracer a few metres away.
THINNEST_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class RepairedMesh:
    """A mesh whose facets are surfaces, each with its outside seen counter-clockwise.

    owner: the part that each face came from.
    two_sided: faces of surfaces that enclose nothing, and so have two outsides.
    """

    vertices_m: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    owner: Int[np.ndarray, " face"]
    two_sided: Bool[np.ndarray, " face"]


def repair(parts: Sequence[MeshPart], name: str) -> RepairedMesh:
    """Return a mesh, in metres with z up, without what is broken in it; what was repaired is logged with its count.

    Parameters
    ----------
    parts:
        The mesh, in metres.
    name:
        The key and the file, for messages.

    Raises
    ------
    InputFileError
        No face is left.

    """
    first = np.cumsum([0, *(len(p.vertices) for p in parts)])
    vertices = np.concatenate([p.vertices for p in parts])
    faces = np.concatenate([p.faces + f for p, f in zip(parts, first, strict=False)])
    owner = np.repeat(np.arange(len(parts)), [len(p.faces) for p in parts])
    counts: dict[str, int] = {}

    usable = np.isfinite(vertices[faces]).all(axis=(1, 2))
    counts["faces with a vertex that is no place"] = int(np.count_nonzero(~usable))
    faces, owner = faces[usable], owner[usable]
    wide = _width(vertices[faces]) > THINNEST_M
    counts["faces without an area"] = int(np.count_nonzero(~wide))
    faces, owner = faces[wide], owner[wide]
    if len(faces) == 0:
        message = f"{name}: none of its {len(usable):,} faces is a surface ({_listed(counts)}); export the mesh again"
        raise InputFileError(message)
    merged = _merged(vertices, faces)
    single = _first_of_each(merged)
    counts["faces that are there twice"] = len(faces) - len(single)
    faces, owner, merged = faces[single], owner[single], merged[single]
    flip, closed = _outward(vertices, faces, merged)
    counts["faces turned inside out"] = int(np.count_nonzero(flip))
    faces[flip] = faces[flip][:, ::-1]
    if any(counts.values()):
        logger.warning("%s: repaired %s, of %s faces", name, _listed(counts), f"{len(usable):,}")
    return RepairedMesh(vertices_m=vertices, faces=faces, owner=owner, two_sided=~closed)


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{count:,} {what}" for what, count in counts.items() if count)


def _width(corner: Float[np.ndarray, "face 3 3"]) -> Float[np.ndarray, " face"]:
    """Return the height of each triangle over its longest side."""
    side = corner - np.roll(corner, 1, axis=1)
    longest = np.sqrt(np.einsum("fki,fki->fk", side, side).max(axis=1, initial=0.0))
    twice_area = np.linalg.norm(np.cross(side[:, 0], side[:, 1]), axis=1)
    return twice_area / np.maximum(longest, 1e-300)


def _merged(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> Int[np.ndarray, "face 3"]:
    """Return faces with one number for all vertices at the same place."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    place = vertices[used] - vertices[used].min(axis=0)
    same = place.max() * SAME_PLACE
    east, north, up = np.round(place / same).astype(np.int64).T
    # Each of the three is below 2^20.
    _, first, cell = np.unique((east << 40) | (north << 20) | up, return_index=True, return_inverse=True)
    number = np.zeros(len(vertices), dtype=np.int64)
    number[used] = _joined(place[first], same)[cell]
    return number[faces]


def _joined(place: Float[np.ndarray, "n 3"], reach: float) -> Int[np.ndarray, " n"]:
    """Return one number for all places within reach of one another, on whichever sides of a cell's border they lie."""
    if len(place) > MAX_JOINED:
        return np.arange(len(place))
    one, other = KDTree(place).query_pairs(reach / 2, output_type="ndarray").T
    graph = coo_array((np.ones(len(one), dtype=bool), (one, other)), shape=(len(place), len(place)))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _first_of_each(faces: Int[np.ndarray, "face 3"]) -> Int[np.ndarray, " single"]:
    """Return the faces, in order, without those whose corners an earlier one has."""
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)
    new = np.ones(len(faces), dtype=bool)
    new[order[1:]] = np.any(corners[order[1:]] != corners[order[:-1]], axis=1)
    return np.flatnonzero(new)


def _outward(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], merged: Int[np.ndarray, "face 3"]
) -> tuple[Bool[np.ndarray, " face"], Bool[np.ndarray, " face"]]:
    """Return masks of the faces to turn, and of the faces of closed surfaces.

    Neighbours are made to agree, by the majority's area. What encloses something, if with gaps, then encloses a
    positive volume; sheets keep their sides, unless all of them together look down more than up.
    """
    count = len(faces)
    one, other, agree, paired = _neighbours(merged)
    # Two nodes for each face, as it is and turned: those that can be so together are connected.
    start = np.concatenate([one, one + count])
    end = np.concatenate([np.where(agree, other, other + count), np.where(agree, other + count, other)])
    graph = coo_array((np.ones(len(start), dtype=bool), (start, end)), shape=(2 * count, 2 * count))
    label = connected_components(graph, directed=False)[1]
    as_is, turned = label[:count], label[count:]
    sided = as_is != turned  # a surface with one side, like Moebius's strip, is left alone
    _, piece = np.unique(np.minimum(as_is, turned), return_inverse=True)
    flip = sided & (turned < as_is)
    area_m2 = _areas(vertices[faces])
    size = np.linalg.norm(area_m2, axis=1)
    flip ^= sided & (np.bincount(piece, size * np.where(flip, 1, -1)) > 0)[piece]
    closed = sided & (np.bincount(piece, ~paired.all(axis=1)) == 0)[piece]

    area_m2[flip] *= -1
    whole = np.column_stack([np.bincount(piece, area_m2[:, axis]) for axis in range(3)])
    solid = sided & (np.linalg.norm(whole, axis=1) < SHEET_SHARE * np.bincount(piece, size))[piece]
    inverted = solid & (_volumes(vertices[faces].mean(axis=1), area_m2, piece) < 0)[piece]
    sheet = sided & ~solid
    if np.sum(area_m2[sheet, 2]) < -DOWNWARD_SHARE * np.sum(size[sheet]):
        inverted |= sheet
    return flip ^ inverted, closed


def _areas(corner: Float[np.ndarray, "face 3 3"]) -> Float[np.ndarray, "face 3"]:
    """Return the area of each face along its normal."""
    return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) / 2


def _volumes(
    centre: Float[np.ndarray, "face 3"], area_m2: Float[np.ndarray, "face 3"], piece: Int[np.ndarray, " face"]
) -> Float[np.ndarray, " piece"]:
    """Return three times the volume that the faces of each piece enclose, gaps closed from its middle."""
    size = np.linalg.norm(area_m2, axis=1)
    total = np.bincount(piece, size)
    middle = np.column_stack([np.bincount(piece, size * centre[:, axis]) / total for axis in range(3)])
    return np.bincount(piece, np.einsum("fi,fi->f", centre - middle[piece], area_m2))


def _neighbours(
    faces: Int[np.ndarray, "face 3"],
) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"], Bool[np.ndarray, " pair"], Bool[np.ndarray, "face 3"]]:
    """Return pairs of faces that share a side of no other face, whether they agree, and which sides are so shared."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = np.minimum(start, end) * (int(faces.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    begins = np.flatnonzero(np.diff(key[order], prepend=-1))
    length = np.diff(begins, append=len(key))
    first = begins[length == 2]
    one, other = order[first], order[first + 1]
    paired = np.zeros(len(key), dtype=bool)
    paired[one] = paired[other] = True
    forward = start < end
    return one // 3, other // 3, forward[one] != forward[other], paired.reshape(-1, 3)
