"""Ground from a mesh file: a site model, a photogrammetric mesh, a scene of Sionna."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from pyproj import CRS

from sionna_radar.elevation.local_frame import MapFrame, frame_about, frame_at, horizontal_crs_of, stated_crs
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Georeference
from sionna_radar.scene.ground_cover import GroundCover, bare_ground, cover_ground
from sionna_radar.scene.landscape import Landscape
from sionna_radar.scene.mesh_files.part import MeshPart
from sionna_radar.scene.mesh_files.repair import RepairedMesh, repair
from sionna_radar.scene.model import Surface
from sionna_radar.scene.objects import (
    MeshSource,
    about_box,
    check_reach,
    corners_of,
    material_of_parts,
    surfaces_of,
    upright,
)
from sionna_radar.scene.raycast import RayCaster

KEY = "terrain"


@dataclass(frozen=True, kw_only=True)
class MeshGround:
    """A mesh as ground: its file, and its place, local or on the map.

    crs: of its coordinates; None for local ones, about `position_m`.
    centre_lonlat_deg: local origin (WGS 84); None for the mesh's middle, or for no place on the map.
    """

    source: MeshSource
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    crs: str | None = None
    centre_lonlat_deg: tuple[float, float] | None = None


def mesh_frame(ground: MeshGround) -> MapFrame | None:
    """Return the local frame of a mesh with map coordinates, or about a stated position; None without either.

    Raises ScenarioError or InputFileError if it cannot be read or does not match its CRS.
    """
    if ground.crs is None:
        return frame_at(*ground.centre_lonlat_deg) if ground.centre_lonlat_deg else None
    return _frame_of(ground, _crs_of(ground.crs), upright(ground.source, KEY))


def mesh(ground: MeshGround, cover: GroundCover) -> Landscape:
    """Return the ground of a mesh file, with the objects in it."""
    parts = upright(ground.source, KEY)
    frame = None
    if ground.crs is not None:
        crs = _crs_of(ground.crs)
        frame = _frame_of(ground, crs, parts)
        parts = tuple(_local(part, crs, frame) for part in parts)
    elif ground.centre_lonlat_deg:
        frame = frame_at(*ground.centre_lonlat_deg)
    parts = about_box(parts, ground.source)
    materials = material_of_parts(parts, ground.source, KEY)
    repaired = repair(parts, f"{KEY}.path = {shown(ground.source.path)}")
    repaired = replace(repaired, vertices_m=repaired.vertices_m + np.array(ground.position_m))
    check_reach(repaired.vertices_m[np.unique(repaired.faces)], f"{KEY}.position_m", ground.source.path)
    georeference = frame.georeference() if frame else None
    surfaces = _covered(repaired, materials, cover, georeference)
    caster = RayCaster(surfaces)
    heights = np.concatenate([s.vertices_m[:, 2] for s in surfaces])
    bottom, top = float(heights.min()) - 10.0, float(heights.max()) + 10.0

    def ground_m(place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        return bare_ground(caster, place_m, bottom, top)

    return Landscape(
        surfaces=tuple(surfaces),
        ground_m=ground_m,
        standing_m=ground_m,
        ground_material=cover.material,
        georeference=georeference,
        may_overhang=True,
        caster=caster,
    )


def _covered(
    mesh: RepairedMesh, materials: list[str], cover: GroundCover, georeference: Georeference | None
) -> tuple[Surface, ...]:
    """Return a mesh as surfaces, with land cover over the faces of the terrain's own material."""
    if cover.bare:
        return surfaces_of(mesh, materials, "terrain-mesh")
    bare = np.array([name == cover.material for name in materials])[mesh.owner]
    if not bare.any():
        message = f"no face is of terrain.material = {cover.material!r}, which it covers; remove it"
        raise ScenarioError.of(f"{KEY}.cover", message)
    kept_vertices, index = np.unique(mesh.faces[bare], return_inverse=True)
    covered = cover_ground(mesh.vertices_m[kept_vertices], index.reshape(-1, 3), cover, georeference)
    two_sided = bool(mesh.two_sided[bare].any())
    covered = tuple(replace(surface, two_sided=two_sided, divided=True) for surface in covered)
    if bare.all():
        return covered
    uncovered = replace(mesh, faces=mesh.faces[~bare], owner=mesh.owner[~bare], two_sided=mesh.two_sided[~bare])
    return covered + surfaces_of(uncovered, materials, "terrain-mesh")


def _crs_of(name: str) -> CRS:
    crs = horizontal_crs_of(stated_crs(name))
    if not crs.is_projected:
        message = f"{crs.name!r} is not projected, and a mesh has no degrees; give one that is, such as 'EPSG:32632'"
        raise ScenarioError.of(f"{KEY}.crs", message)
    return crs


def _frame_of(ground: MeshGround, crs: CRS, parts: Sequence[MeshPart]) -> MapFrame:
    """Return the frame of a mesh with map coordinates: its own projection or UTM zone, with a rounded origin."""
    (west, south, _), (east, north, _) = corners_of(parts)
    x, y = np.round(np.array([west + east, south + north]) / 2 / _metres(crs))
    return frame_about(crs, (float(x), float(y)), ground.centre_lonlat_deg, "mesh's middle")


def _local(part: MeshPart, crs: CRS, frame: MapFrame) -> MeshPart:
    """Return a part in local metres; the map offset is subtracted in float64."""
    x, y = part.vertices[:, :2].T / _metres(crs)
    if frame.crs is crs:
        east, north = x - frame.origin_m[0], y - frame.origin_m[1]
    else:
        east, north = frame.local_of(crs, x, y)
    return MeshPart(name=part.name, vertices=np.column_stack([east, north, part.vertices[:, 2]]), faces=part.faces)


def _metres(crs: CRS) -> float:
    """Return metres of one unit of a projected CRS."""
    return float(crs.axis_info[0].unit_conversion_factor)
