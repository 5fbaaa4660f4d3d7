"""Placing mesh files in the scene: units, axes, heading, materials, and the ground that they stand on."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from sionna_radar.foundation.errors import InputFileError, Problem, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.scenario.objects import MeshObject
from sionna_radar.scenario.terrain import MeshFile, MeshShape
from sionna_radar.scene.mesh_files.part import MeshPart
from sionna_radar.scene.mesh_files.reader import read_mesh, up_axis
from sionna_radar.scene.mesh_files.repair import RepairedMesh, repair
from sionna_radar.scene.model import Surface

Heights = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]

LARGEST_M, SMALLEST_M = 100_000.0, 1e-3
SIONNA_PREFIX = "mat-"
# Places along each side of the box around an outline where the ground under it is looked up.
GROUND_SAMPLES = 21


def upright(table: MeshShape, key: str) -> tuple[MeshPart, ...]:
    """Return a mesh file in metres, z up, turned to its heading, about its own origin.

    Raises InputFileError if it cannot be read or is of no size that a survey can see.
    """
    parts = read_mesh(table.path, f"{key}.path")
    turn = np.eye(3)
    if (table.up or up_axis(table.path)) == "y":
        turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    heading = np.deg2rad(table.heading_deg)
    cos, sin = np.cos(heading), np.sin(heading)
    turn = table.metres_per_unit * np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ turn
    with np.errstate(over="ignore", invalid="ignore"):  # what is no place by then is found below
        placed = tuple(MeshPart(name=p.name, vertices=p.vertices @ turn.T, faces=p.faces) for p in parts)
        _check_size(placed, table, key)
    return placed


def about_box(parts: Sequence[MeshPart], table: MeshFile) -> tuple[MeshPart, ...]:
    """Return an upright mesh about what of it stands at its position."""
    if table.centre == "origin":
        return tuple(parts)
    low, high = corners_of(parts)
    middle = np.array([*(low + high)[:2] / 2, low[2]])
    return tuple(MeshPart(name=p.name, vertices=p.vertices - middle, faces=p.faces) for p in parts)


def box_text(place_m: Float[np.ndarray, "n 3"]) -> str:
    """Return the box around some places, in words."""
    ends = zip("xyz", place_m.min(axis=0), place_m.max(axis=0), strict=True)
    return ", ".join(f"{axis} = {low:.1f} to {high:.1f} m" for axis, low, high in ends)


def placed_boxes(surfaces: Sequence[Surface]) -> dict[str, str]:
    """Return the bounding boxes of a scene's meshes, in words, by their keys in the scenario."""
    corners: dict[str, list[Float[np.ndarray, "2 3"]]] = {}
    for surface in surfaces:
        kind, number, *_ = f"{surface.name}--".split("-")
        key = {"object": f"objects.{number}", "terrain": "terrain"}.get(kind) if surface.divided else None
        if key:
            corners.setdefault(key, []).append(surface.bounds_m)
    return {key: box_text(np.concatenate(ends)) for key, ends in corners.items()}


def _far_from_origin(place_m: Float[np.ndarray, "n 3"]) -> str:
    """Return the note on a mesh that lies farther from its own origin than it is large; empty for others."""
    low, high = place_m.min(axis=0), place_m.max(axis=0)
    away_m = float(np.linalg.norm((low + high)[:2] / 2))
    if away_m <= float(np.max(high - low)):
        return ""
    return f"; its file's origin lies {away_m:,.0f} m from the middle of its box: set centre = 'box'"


def _check_size(parts: Sequence[MeshPart], table: MeshShape, key: str) -> None:
    low, high = corners_of(parts)
    largest = float(np.max(high - low))
    named = f"{key}.path = {shown(table.path)}"
    if not np.isfinite(largest):
        message = f"{named}: none of its vertices is a place; export the mesh again"
        raise InputFileError(message)
    if largest > LARGEST_M:
        message = f"{named}: is {largest / 1000:,.0f} km across in units = '{table.units}'; set units = 'mm' or a scale"
        raise InputFileError(message)
    if largest < SMALLEST_M:
        message = f"{named}: is {largest * 1000:.3g} mm across in units = '{table.units}'; set units = 'km' or a scale"
        raise InputFileError(message)


def corners_of(parts: Sequence[MeshPart]) -> Float[np.ndarray, "2 3"]:
    """Return the lowest and highest corner of the box around the faces of a mesh; NaN if it has no place."""
    used = np.concatenate([p.vertices[np.unique(p.faces)] for p in parts])
    used = used[np.isfinite(used).all(axis=1)]
    if len(used) == 0:
        return np.full((2, 3), np.nan)
    return np.array([used.min(axis=0), used.max(axis=0)])


def material_of_parts(parts: Sequence[MeshPart], table: MeshFile, key: str) -> list[str]:
    """Return the scenario's material of each part.

    Raises ScenarioError for a table of materials with names that the mesh does not have.
    """
    wanted = {name.removeprefix(SIONNA_PREFIX): material for name, material in table.materials.items()}
    own = [part.name.removeprefix(SIONNA_PREFIX) for part in parts]
    unknown = sorted(set(wanted) - set(own))
    if unknown:
        known = ", ".join(shown(name) for name in sorted(set(own) - {""})) or "no names at all; use material alone"
        message = f"the mesh has no {', '.join(shown(name) for name in unknown)}; it has {known[:1000]}"
        raise ScenarioError([Problem(f"{key}.materials", message)])
    return [wanted.get(name, table.material) for name in own]


def surfaces_of(mesh: RepairedMesh, materials: Sequence[str], name: str) -> tuple[Surface, ...]:
    """Return a mesh as surfaces: one for the closed and one for the open parts of each material, in their order."""
    names = list(dict.fromkeys(materials))
    number = np.array([names.index(m) for m in materials])[mesh.owner] * 2 + mesh.two_sided
    surfaces = []
    for which in np.unique(number):
        used, index = np.unique(mesh.faces[number == which], return_inverse=True)
        surfaces.append(
            Surface(
                name=f"{name}-{which}",
                vertices_m=mesh.vertices_m[used],
                faces=index.reshape(-1, 3).astype(np.int64),
                material=names[which // 2],
                two_sided=bool(which % 2),
                divided=True,
            )
        )
    return tuple(surfaces)


@dataclass(frozen=True, kw_only=True)
class ReadObject:
    """A repaired mesh about its own origin, with the scenario's material of each of its parts."""

    mesh: RepairedMesh
    materials: list[str]


def build_objects(tables: Sequence[MeshObject], ground_m: Heights, datum_m: float) -> tuple[Surface, ...]:
    """Return objects as surfaces, one or two for each material of each; copies of one file are read once.

    Parameters
    ----------
    tables:
        The scenario's objects.
    ground_m:
        Height of the ground at horizontal positions; NaN beyond the terrain.
    datum_m:
        Height of the local origin in the heights of the terrain.

    Raises
    ------
    ScenarioError, InputFileError
        One stands beyond the terrain, names materials that its file does not have, or its file cannot be used.

    """
    known: dict[str, ReadObject] = {}
    surfaces: list[Surface] = []
    for index, table in enumerate(tables):
        same = table.model_dump_json(exclude={"position_m", "on_ground"})
        if same not in known:
            known[same] = _read(table, f"objects.{index}")
        surfaces += _placed(table, index, known[same], ground_m, datum_m)
    return tuple(surfaces)


def _read(table: MeshObject, key: str) -> ReadObject:
    parts = about_box(upright(table, key), table)
    materials = material_of_parts(parts, table, key)
    return ReadObject(mesh=repair(parts, f"{key}.path = {shown(table.path)}"), materials=materials)


def _placed(table: MeshObject, index: int, found: ReadObject, ground_m: Heights, datum_m: float) -> tuple[Surface, ...]:
    """Return an object where it stands."""
    mesh, key = found.mesh, f"objects.{index}.position_m"
    east, north, *height = table.position_m
    used = mesh.vertices_m[np.unique(mesh.faces)]
    if table.on_ground:
        ground = float(np.min(ground_m(_under(used[:, :2]) + np.array([east, north]))))
        if not np.isfinite(ground):
            box = box_text(used + np.array([east, north, 0.0])).rsplit(", z", 1)[0]
            message = (
                f"the object at {table.position_m}, {box}, extends beyond the terrain; move it or enlarge the terrain"
                f"{_far_from_origin(used)}"
            )
            raise ScenarioError([Problem(key, message)])
        up = ground - float(used[:, 2].min())
    else:
        up = height[0] - datum_m
    placed = replace(mesh, vertices_m=mesh.vertices_m + np.array([east, north, up]))
    check_reach(placed.vertices_m[np.unique(placed.faces)], key, table.path)
    return surfaces_of(placed, found.materials, f"object-{index}")


def check_reach(place_m: Float[np.ndarray, "n 3"], key: str, path: Path) -> None:
    """Refuse a mesh so far from the local origin that float32 loses its shape.

    Raises ScenarioError for the key that places it.
    """
    farthest = float(np.abs(place_m).max())
    if farthest > LARGEST_M:
        message = (
            f"{shown(path)} lies up to {farthest / 1000:,.0f} km from the local origin, {box_text(place_m)}; place it "
            "nearer, set centre = 'box', or, if its coordinates are those of a map, give terrain.crs of a mesh terrain"
        )
        raise ScenarioError([Problem(key, message)])


def _under(plan_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "k 2"]:
    """Return places within the convex outline of a mesh in plan: its corners, and samples inside."""
    low, high = plan_m.min(axis=0), plan_m.max(axis=0)
    share = np.linspace(0.0, 1.0, GROUND_SAMPLES)
    grid = np.stack(np.meshgrid(*(a + share * (b - a) for a, b in zip(low, high, strict=True))), axis=-1).reshape(-1, 2)
    try:
        hull = ConvexHull(plan_m)
    except QhullError:  # a line in plan, or a point
        return np.unique(plan_m, axis=0)
    inside = np.all(grid @ hull.equations[:, :2].T + hull.equations[:, 2] <= 1e-9, axis=1)
    return np.concatenate([plan_m[hull.vertices], grid[inside]])
