"""The contents of a scene, in plain arrays that any engine can use."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.georeference import Georeference
from sionna_radar.foundation.raster import Raster
from sionna_radar.scene.body import Body
from sionna_radar.scene.motion import RcsTable, Rotor, Way
from sionna_radar.scene.vegetation import Vegetation
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.motion import SurfaceMotion


@dataclass(frozen=True, kw_only=True)
class Surface:
    """A triangle mesh of one material, world frame; triangles are counter-clockwise seen from outside.

    two_sided: it encloses nothing, so that both of its sides are an outside.
    relief: the heights of which it has all triangles, in the order of `mesh.mesh_of`; None for any other surface.
    divided: its walls may be of triangles of any size, as in a mesh file; those of others are as high as they are.
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
    way: along which it moves; None for one that stands at its position.
    heading_rad: of one that stands, clockwise from north.
    rcs_table: its cross-section by angle; None for `rcs_m2` in all directions.
    rotors: blades that turn on it.
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


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Everything the radar can see.

    materials: how each scatters; one that distinguishes V, H and specular reflection is a `RadarMaterial`.
    ground_material: the material of the ground where a single one is needed, as for a reference echo.
    georeference: None if the scene is not georeferenced.
    vegetation: None if nothing grows.
    motions: what the wind moves, by material; others stand still.
    """

    surfaces: tuple[Surface, ...]
    materials: dict[str, Backscatter]
    targets: tuple[Target, ...]
    ground_material: str
    georeference: Georeference | None
    vegetation: Vegetation | None = None
    motions: Mapping[str, SurfaceMotion] = field(default_factory=dict)

    @cached_property
    def bounds_m(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of the box around all surfaces."""
        low, high = zip(*(surface.bounds_m for surface in self.surfaces), strict=True)
        return np.array([np.min(low, axis=0), np.max(high, axis=0)])
