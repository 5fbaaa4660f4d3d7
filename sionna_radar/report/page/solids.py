"""What stands on the ground, as triangles: buildings, objects and footprints within a box."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.report.page.packing import Pack
from sionna_radar.scene.model import Scene, Surface

# A surface of which this share is steep stands on the ground rather than being it.
STEEP_SHARE, STEEP_COSINE = 0.1, 0.2
MOST_FACES = 60_000
CITY = "sionna:"


@dataclass(frozen=True, kw_only=True)
class Solids:
    """Triangles, and how many there were within the box."""

    vertices_m: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    total: int

    @property
    def note(self) -> str:
        """What was left out, in words; empty for nothing."""
        if self.total == len(self.faces):
            return ""
        return f"the {len(self.faces):,} largest of {self.total:,} triangles of buildings are shown"

    def packed(self, pack: Pack) -> dict[str, Any]:
        """Return the triangles for a page."""
        return {"vertices": pack.exact(self.vertices_m), "faces": pack.whole(self.faces)}


def standing(surface: Surface, terrain: str) -> bool:
    """Whether a surface stands on the ground: it is named so by what builds it, or is steep by area.

    terrain: the kind of terrain; the roofs of Sionna's cities are surfaces of their own.
    """
    names = ("building-", "footprints-", *([f"{terrain.removeprefix(CITY)}-"] if terrain.startswith(CITY) else []))
    if surface.name.startswith(names):
        return True
    normal = _normals(surface.vertices_m, surface.faces)
    area = np.linalg.norm(normal, axis=1)
    steep = np.abs(normal[:, 2]) < STEEP_COSINE * area
    return bool(area[steep].sum() > STEEP_SHARE * area.sum())


def solids_within(scene: Scene, terrain: str, box: tuple[float, float, float, float]) -> Solids | None:
    """Return what stands within a box (west, east, south, north); None for nothing."""
    vertices, faces, first = [], [], 0
    for surface in (surface for surface in scene.surfaces if standing(surface, terrain)):
        inside = surface.faces[_within(surface, box)]
        if len(inside):
            used, index = np.unique(inside, return_inverse=True)
            vertices.append(surface.vertices_m[used])
            faces.append(index.reshape(-1, 3) + first)
            first += len(used)
    if not faces:
        return None
    vertices_m, triangles = np.concatenate(vertices), np.concatenate(faces)
    total = len(triangles)
    if total > MOST_FACES:
        area = np.linalg.norm(_normals(vertices_m, triangles), axis=1)
        triangles = triangles[np.argsort(-area, kind="stable")[:MOST_FACES]]
    return Solids(vertices_m=vertices_m, faces=triangles, total=total)


def _within(surface: Surface, box: tuple[float, float, float, float]) -> Bool[np.ndarray, " face"]:
    west, east, south, north = box
    x, y = surface.vertices_m[:, 0], surface.vertices_m[:, 1]
    inside = (x >= west) & (x <= east) & (y >= south) & (y <= north)
    return inside[surface.faces].any(axis=1)


def _normals(
    vertices_m: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> Float[np.ndarray, "face 3"]:
    a, b, c = (vertices_m[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)
