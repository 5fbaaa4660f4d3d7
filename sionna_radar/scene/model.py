"""Data model of a scene in plain arrays (surfaces, targets, bodies, materials), and meshes of elevation rasters.

Bodies of targets are shapes in their own axes: right, forward and up.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.foundation.raster import Georeference, Raster
from sionna_radar.scene.motion import RcsTable, Rotor, Way
from sionna_radar.scene.vegetation import PlantCover
from sionna_radar.scene.wires import ThinObstacle
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.motion import SurfaceMotion


# Hashed by identity: arrays have no hash.
@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Triangles small enough for the plane-wave approximation.

    vertices_m: right, forward and up.
    faces: counter-clockwise seen from outside. two_sided: mask of the faces of open sheets.
    reflectivity: of its surface, power over that of a perfect conductor.
    """

    vertices_m: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    two_sided: Bool[np.ndarray, " face"]
    reflectivity: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Surface:
    """A triangle mesh of one material, world frame; triangles are counter-clockwise seen from outside.

    two_sided: whether it is open, so that both of its sides are outside.
    relief: the raster whose triangles it consists of, in the order of `mesh_of`; None for any other surface.
    divided: whether walls may consist of triangles of any size, as in a mesh file; otherwise they span the full height.
    """

    name: str
    vertices_m: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    material: str
    two_sided: bool = False
    divided: bool = False
    relief: Raster | None = None

    @cached_property
    def bounds_m(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of the box around it."""
        # Column by column, which is far faster than over an axis of three.
        return np.array([[function(column) for column in self.vertices_m.T] for function in (np.min, np.max)])


@dataclass(frozen=True, kw_only=True)
class Target:
    """A point target: its position, mean radar cross-section, and fluctuation.

    swerling: 0 for a constant one, 1 to 4 for Swerling's cases (see `tracing.effects.targets`).
    way: its path; None for a static target.
    heading_rad: of a static target, clockwise from north.
    rcs_table: its cross-section by angle; None for `rcs_m2` in all directions.
    rotors: its rotating blades.
    body: its shape; None for a point.
    """

    position_m: tuple[float, float, float]
    rcs_m2: float
    swerling: int = 0
    way: Way | None = None
    heading_rad: float = 0.0
    rcs_table: RcsTable | None = None
    rotors: tuple[Rotor, ...] = ()
    body: Body | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Everything visible to the radar.

    materials: how each scatters; one that distinguishes V, H and specular reflection is a `RadarMaterial`.
    ground_material: the material of the ground where a single one is needed, as for a reference echo.
    georeference: None if the scene is not georeferenced.
    vegetation: None without plants.
    motions: motions in the wind by material; others are static.
    thin: wires, poles and fences.
    """

    surfaces: tuple[Surface, ...]
    materials: dict[str, Backscatter]
    targets: tuple[Target, ...]
    ground_material: str
    georeference: Georeference | None
    vegetation: PlantCover | None = None
    motions: Mapping[str, SurfaceMotion] = field(default_factory=dict)
    thin: tuple[ThinObstacle, ...] = ()

    @cached_property
    def bounds_m(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of the box around all surfaces."""
        lower, upper = zip(*(surface.bounds_m for surface in self.surfaces), strict=True)
        return np.array([np.min(lower, axis=0), np.max(upper, axis=0)])

    def covers(self, surface: Int[np.ndarray, " n"], place_m: Float[np.ndarray, "n 2"]) -> np.ndarray:
        """Return the covers by name of places on surfaces, counted from 0: vegetation, or the surface's material.

        Empty for the surface -1, which is none.
        """
        name = np.where(surface >= 0, np.array([own.material for own in self.surfaces])[surface], "")
        if self.vegetation is None:
            return name
        return np.where((surface >= 0) & np.isfinite(self.vegetation.at(place_m)), "vegetation", name)


def mesh_of(raster: Raster) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Return vertices and triangles of a raster: two triangles per four filled neighbours.

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
    complete = filled[:-1, :-1] & filled[:-1, 1:] & filled[1:, :-1] & filled[1:, 1:]
    faces = _two_triangles([corner[complete] for corner in corners])

    referenced = np.zeros(index.size, dtype=bool)
    referenced[faces] = True
    renumbered = np.cumsum(referenced) - 1
    vertices = np.column_stack([raster.grid.centres_m[referenced], raster.height_m.ravel()[referenced]])
    return vertices.astype(np.float64), renumbered[faces]


def _whole(raster: Raster) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Return vertices and triangles of a raster without empty cells."""
    rows, columns = raster.grid.shape
    vertices = np.empty((rows, columns, 3))
    vertices[..., 0], vertices[..., 1], vertices[..., 2] = raster.grid.x_m, raster.grid.y_m[:, None], raster.height_m
    kind = np.int32 if rows * columns < 2**31 else np.int64
    corner = np.arange(rows * columns, dtype=kind).reshape(rows, columns)
    faces = _two_triangles([corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]])
    return vertices.reshape(-1, 3), faces


def _two_triangles(corners: list[Int[np.ndarray, "..."]]) -> Int[np.ndarray, "face 3"]:
    """Return two triangles for each square of corners a, b, c, d."""
    a, b, c, d = (corner.ravel() for corner in corners)
    faces = np.empty((len(a), 2, 3), dtype=a.dtype)
    for column, corner in enumerate((a, b, d)):
        faces[:, 0, column] = corner
    for column, corner in enumerate((a, d, c)):
        faces[:, 1, column] = corner
    return faces.reshape(-1, 3)
