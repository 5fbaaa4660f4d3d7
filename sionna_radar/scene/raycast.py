"""Ray casting against the meshes of a scene: true heights from above, and visibility."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int, Integer

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.foundation.threads import over_rows
from sionna_radar.raytracer.backend import aligned, aligned_room, flushed_denormals, load_mitsuba
from sionna_radar.scene.model import Surface
from sionna_radar.scene.relief import Relief

Value = TypeVar("Value")

# Offset of the second vertical ray that detects slips between triangles, and the least difference of a slip.
EDGE_STEP_M = np.array([7e-4, 4e-4])
EDGE_JUMP_M = 0.01


@dataclass(frozen=True, kw_only=True)
class Hits:
    """First hits of rays; a miss has infinite distance and surface -1.

    face: triangle in the surface; undefined for a miss.
    cosine: of the angle between the ray and the surface's normal, not negative; undefined for a miss.
    """

    distance_m: Float[np.ndarray, " ray"]
    surface: Int[np.ndarray, " ray"]
    face: Int[np.ndarray, " ray"]
    cosine: Float[np.ndarray, " ray"]

    @property
    def hit(self) -> Bool[np.ndarray, " ray"]:
        """Mask of rays with a hit."""
        return np.isfinite(self.distance_m)


def mitsuba_mesh(surface: Surface) -> Any:
    """Return a surface as a Mitsuba mesh with flat faces."""
    mi = load_mitsuba()
    mesh = mi.Mesh(surface.name, len(surface.vertices_m), len(surface.faces), has_vertex_normals=False)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(surface.vertices_m.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(surface.faces.astype(np.uint32).ravel())
    parameters.update()
    return mesh


class _Meshes:
    """Some surfaces as a scene of Mitsuba.

    surface_of_shape: surface number by shape pointer (as an integer); -1 for none.
    """

    @flushed_denormals()
    def __init__(self, surfaces: Mapping[int, Surface]) -> None:
        mi = load_mitsuba()
        import drjit as dr

        meshes = {f"surface-{number}": mitsuba_mesh(surface) for number, surface in surfaces.items()}
        self.mi_scene = mi.load_dict({"type": "scene", **meshes})
        ids = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(mesh))[0]) for mesh in meshes.values()]
        self.surface_of_shape = np.full(max(ids) + 1, -1)
        self.surface_of_shape[ids] = list(surfaces)


def _rays(
    origin_m: Float[np.ndarray, "origin 3"],
    row: Integer[np.ndarray, " ray"],
    point_m: Float[np.ndarray, "ray 3"],
    short: float,
) -> Any:
    """Return rays from the origins in given rows that end short of points, in the memory of the ray tracer."""
    mi = load_mitsuba()
    import drjit as dr

    direction, length = [aligned_room(len(row)) for _ in range(3)], aligned_room(len(row))
    ends = np.ascontiguousarray(origin_m, dtype=np.float64), row, point_m, 1 - short, *direction, length
    over_rows(lambda low, high: _directions(low, high, *ends), len(row))
    origin = dr.gather(mi.Point3f, mi.Point3f(*map(aligned, origin_m.T)), mi.UInt32(aligned(row, np.uint32)))
    ray = mi.Ray3f(origin, mi.Vector3f(*direction))
    ray.maxt = mi.Float(length)
    return ray


@compiled
@no_type_check
def _directions(low, high, origin, row, point, fraction, to_x, to_y, to_z, length):
    for ray in range(low, high):
        start = origin[row[ray]]
        x, y, z = point[ray, 0] - start[0], point[ray, 1] - start[1], point[ray, 2] - start[2]
        distance = np.sqrt(x * x + y * y + z * z)
        to_x[ray], to_y[ray], to_z[ray] = x / distance, y / distance, z / distance
        length[ray] = distance * fraction


class RayCaster:
    """Casts rays against a set of surfaces: ground on a grid by its heights, all others by Mitsuba."""

    def __init__(self, surfaces: Sequence[Surface]) -> None:
        self._derived: dict[str, tuple[Hashable, Any]] = {}
        self._surfaces = dict(enumerate(surfaces))
        self._reliefs = {n: Relief(s.relief) for n, s in self._surfaces.items() if s.relief is not None}

    @cached_property
    def _whole(self) -> _Meshes:
        return _Meshes(self._surfaces)

    @cached_property
    def _others(self) -> _Meshes | None:
        if not self._reliefs:
            return self._whole
        meshes = {n: s for n, s in self._surfaces.items() if n not in self._reliefs}
        return _Meshes(meshes) if meshes else None

    @property
    def mi_scene(self) -> Any:
        """All surfaces as a scene of Mitsuba."""
        return self._whole.mi_scene

    @property
    def surface_of_shape(self) -> Int[np.ndarray, " shape"]:
        """Surface number by shape pointer (as an integer) of `mi_scene`; -1 for none."""
        return self._whole.surface_of_shape

    def once(self, what: str, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return a value derived from the surfaces and the key; the latest one of each name is cached."""
        known, value = self._derived.get(what, (None, None))
        if known != key:
            self._derived.pop(what, None)
            value = make()
            self._derived[what] = key, value
        return value

    def cast(self, origin_m: Float[np.ndarray, "ray 3"], direction: Float[np.ndarray, "ray 3"]) -> Hits:
        """Return the first hits of rays along unit vectors."""
        misses = np.full(len(origin_m), -1)
        hits = Hits(distance_m=np.full(len(misses), np.inf), surface=misses, face=misses, cosine=np.zeros(len(misses)))
        if len(origin_m) == 0:  # Dr.Jit crashes on empty arrays
            return hits
        if self._others is not None:
            hits = self._cast_meshes(self._others, origin_m, direction)
        for surface, relief in self._reliefs.items():
            distance, face, cosine = relief.first_hits(origin_m, direction)
            nearer = distance < hits.distance_m
            hits = Hits(
                distance_m=np.where(nearer, distance, hits.distance_m),
                surface=np.where(nearer, surface, hits.surface),
                face=np.where(nearer, face, hits.face),
                cosine=np.where(nearer, cosine, hits.cosine),
            )
        return hits

    @flushed_denormals()
    def _cast_meshes(
        self, meshes: _Meshes, origin_m: Float[np.ndarray, "ray 3"], direction: Float[np.ndarray, "ray 3"]
    ) -> Hits:
        mi = load_mitsuba()
        import drjit as dr

        ray = self.prepare(origin_m, direction)
        interaction = meshes.mi_scene.ray_intersect(ray)
        dr.eval(interaction.t, interaction.p, interaction.n, interaction.prim_index, interaction.shape)
        hit = interaction.is_valid()
        distance = dr.select(hit, interaction.t, np.inf)
        shape = dr.select(hit, dr.reinterpret_array(mi.UInt32, interaction.shape), 0)
        cosine = dr.minimum(dr.abs(dr.dot(interaction.n, ray.d)), 1.0)
        return Hits(
            distance_m=distance.numpy().astype(np.float64),
            surface=np.where(hit.numpy(), meshes.surface_of_shape[shape.numpy()], -1),
            face=interaction.prim_index.numpy().astype(np.int64),
            cosine=cosine.numpy().astype(np.float64),
        )

    def prepare(self, origin_m: Float[np.ndarray, "ray 3"], direction: Float[np.ndarray, "ray 3"]) -> Any:
        """Return rays in the memory of the ray tracer."""
        mi = load_mitsuba()
        import drjit as dr

        ray = mi.Ray3f(mi.Point3f(*map(aligned, origin_m.T)), mi.Vector3f(*map(aligned, direction.T)))
        dr.eval(ray)
        return ray

    @flushed_denormals()
    def intersect(self, ray: Any) -> Any:
        """Return Mitsuba's surface interactions of prepared rays, fully evaluated."""
        import drjit as dr

        interaction = self.mi_scene.ray_intersect(ray)
        dr.eval(interaction.t, interaction.p, interaction.n, interaction.prim_index, interaction.shape)
        dr.sync_thread()
        return interaction

    def visible(
        self,
        origin_m: Float[np.ndarray, "ray 3"],
        point_m: Float[np.ndarray, "ray 3"],
        tolerance_m: float = 0.01,
    ) -> Bool[np.ndarray, " ray"]:
        """Return True where points are visible from origins; a point may lie on a surface within the tolerance."""
        offset_m = point_m - origin_m
        distance = np.linalg.norm(offset_m, axis=1)
        return self.cast(origin_m, offset_m / distance[:, None]).distance_m >= distance - tolerance_m

    @flushed_denormals()
    def hides(
        self,
        origin_m: Float[np.ndarray, "origin 3"],
        row: Integer[np.ndarray, " ray"],
        point_m: Float[np.ndarray, "ray 3"],
        short: float,
    ) -> Bool[np.ndarray, " ray"]:
        """Return True where anything is between points and the origins in given rows.

        The last fraction `short` of the path is ignored.
        """
        hidden = np.zeros(len(row), dtype=bool)
        if len(row) == 0:
            return hidden
        if self._others is not None:
            hidden |= self._others.mi_scene.ray_test(_rays(origin_m, row, point_m, short)).numpy()
        for relief in self._reliefs.values():
            hidden |= relief.hides(origin_m, row, point_m, short)
        return hidden

    def from_above(self, point_m: Float[np.ndarray, "n 2"], top_m: float) -> Float[np.ndarray, " n"]:
        """Return the height of the highest surface at horizontal positions, seen from `top_m`; NaN if none."""
        return self._vertical(point_m, top_m, -1.0)

    def from_below(self, point_m: Float[np.ndarray, "n 2"], bottom_m: float) -> Float[np.ndarray, " n"]:
        """Return the height of the lowest surface at horizontal positions, seen from `bottom_m`."""
        return self._vertical(point_m, bottom_m, 1.0)

    def _vertical(self, point_m: Float[np.ndarray, "n 2"], start_m: float, direction: float) -> Float[np.ndarray, " n"]:
        height_m = self._plumb(point_m, start_m, direction)
        # A ray may slip through the edge between two triangles; a slightly offset one then decides.
        offset_height_m = self._plumb(point_m + EDGE_STEP_M, start_m, direction)
        slipped = np.nan_to_num(direction * (height_m - offset_height_m), nan=np.inf) > EDGE_JUMP_M
        return np.where(slipped & np.isfinite(offset_height_m), offset_height_m, height_m)

    def _plumb(self, point_m: Float[np.ndarray, "n 2"], start_m: float, direction: float) -> Float[np.ndarray, " n"]:
        origin = np.column_stack([point_m, np.full(len(point_m), start_m)])
        hits = self.cast(origin, np.broadcast_to([0.0, 0.0, direction], origin.shape))
        return np.where(hits.hit, start_m + direction * np.where(hits.hit, hits.distance_m, 0.0), np.nan)


def truth_dem(caster: RayCaster, grid: Grid, top_m: float) -> Raster:
    """Return the height hit by a vertical ray from above at every cell centre."""
    return Raster(grid=grid, height_m=caster.from_above(grid.centres_m, top_m).reshape(grid.shape))
