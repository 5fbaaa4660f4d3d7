"""Ground from a mesh file: a site model, a photogrammetric mesh, a scene of Sionna."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from pyproj import CRS

from sionna_radar.elevation.local_frame import MapFrame, frame_about, frame_at, map_part, stated_crs
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Georeference
from sionna_radar.scenario.terrain import MeshTerrain
from sionna_radar.scene.ground_cover import bare_ground, cover_ground
from sionna_radar.scene.landscape import Landscape, TerrainInputs
from sionna_radar.scene.mesh_files.part import MeshPart
from sionna_radar.scene.mesh_files.repair import RepairedMesh, repair
from sionna_radar.scene.model import Surface
from sionna_radar.scene.objects import about_box, check_reach, corners_of, material_of_parts, surfaces_of, upright
from sionna_radar.scene.raycast import RayCaster

KEY = "terrain"


def mesh_frame(terrain: MeshTerrain) -> MapFrame | None:
    """Return the local frame of a mesh with map coordinates, or about a stated position; None without either.

    Raises ScenarioError or InputFileError if it cannot be read or does not match its CRS.
    """
    if terrain.crs is None:
        return frame_at(*terrain.centre_lonlat_deg) if terrain.centre_lonlat_deg else None
    return _frame_of(terrain, _crs_of(terrain.crs), upright(terrain, KEY))


def mesh(terrain: MeshTerrain, given: TerrainInputs) -> Landscape:
    """Return the ground of a mesh file, with the objects in it."""
    parts = upright(terrain, KEY)
    frame = None
    if terrain.crs is not None:
        crs = _crs_of(terrain.crs)
        frame = _frame_of(terrain, crs, parts)
        parts = tuple(_local(part, crs, frame) for part in parts)
    elif terrain.centre_lonlat_deg:
        frame = frame_at(*terrain.centre_lonlat_deg)
    parts = about_box(parts, terrain)
    materials = material_of_parts(parts, terrain, KEY)
    repaired = repair(parts, f"{KEY}.path = {shown(terrain.path)}")
    repaired = replace(repaired, vertices_m=repaired.vertices_m + np.array(terrain.position_m))
    check_reach(repaired.vertices_m[np.unique(repaired.faces)], f"{KEY}.position_m", terrain.path)
    georeference = frame.georeference() if frame else None
    surfaces = _covered(repaired, materials, terrain, georeference)
    caster = RayCaster(surfaces)
    heights = np.concatenate([s.vertices_m[:, 2] for s in surfaces])
    bottom, top = float(heights.min()) - 10.0, float(heights.max()) + 10.0

    def ground_m(place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        return bare_ground(caster, place_m, bottom, top)

    return Landscape(
        surfaces=tuple(surfaces),
        ground_m=ground_m,
        standing_m=ground_m,
        ground_material=terrain.material,
        georeference=georeference,
        may_overhang=True,
    )


def _covered(
    mesh: RepairedMesh, materials: list[str], terrain: MeshTerrain, georeference: Georeference | None
) -> tuple[Surface, ...]:
    """Return a mesh as surfaces, with land cover over the faces of the terrain's own material."""
    if terrain.cover_raster is None and terrain.cover_vector is None and not terrain.cover:
        return surfaces_of(mesh, materials, "terrain-mesh")
    bare = np.array([name == terrain.material for name in materials])[mesh.owner]
    if not bare.any():
        message = f"no face is of terrain.material = {terrain.material!r}, which it covers; remove it"
        raise ScenarioError([Problem(f"{KEY}.cover", message)])
    kept_vertices, index = np.unique(mesh.faces[bare], return_inverse=True)
    ground = cover_ground(mesh.vertices_m[kept_vertices], index.reshape(-1, 3), terrain, georeference)
    two_sided = bool(mesh.two_sided[bare].any())
    ground = tuple(replace(surface, two_sided=two_sided, divided=True) for surface in ground)
    if bare.all():
        return ground
    uncovered = replace(mesh, faces=mesh.faces[~bare], owner=mesh.owner[~bare], two_sided=mesh.two_sided[~bare])
    return ground + surfaces_of(uncovered, materials, "terrain-mesh")


def _crs_of(name: str) -> CRS:
    crs = map_part(stated_crs(name))
    if not crs.is_projected:
        message = f"{crs.name!r} is not projected, and a mesh has no degrees; give one that is, such as 'EPSG:32632'"
        raise ScenarioError([Problem(f"{KEY}.crs", message)])
    return crs


def _frame_of(terrain: MeshTerrain, crs: CRS, parts: Sequence[MeshPart]) -> MapFrame:
    """Return the frame of a mesh with map coordinates: its own projection or UTM zone, with a rounded origin."""
    (west, south, _), (east, north, _) = corners_of(parts)
    x, y = np.round(np.array([west + east, south + north]) / 2 / _metres(crs))
    return frame_about(crs, (float(x), float(y)), terrain.centre_lonlat_deg, "mesh's middle")


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
