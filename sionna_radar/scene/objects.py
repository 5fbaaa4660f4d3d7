"""Placement of mesh files in the scene: units, axes, heading, materials, and the ground below.

Targets of a scene: points, tables of cross-sections, and bodies from meshes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import read_numbers, shown
from sionna_radar.foundation.raster import Heights
from sionna_radar.scene.mesh_files.part import MeshPart
from sionna_radar.scene.mesh_files.reader import read_mesh, up_axis
from sionna_radar.scene.mesh_files.repair import RepairedMesh, repair
from sionna_radar.scene.model import Body, Surface
from sionna_radar.scene.motion import RcsTable, Way

LARGEST_M, SMALLEST_M = 100_000.0, 1e-3
SIONNA_PREFIX = "mat-"
# Ground samples along each side of the bounding box of an outline.
GROUND_SAMPLES = 21


@dataclass(frozen=True, kw_only=True)
class MeshSource:
    """A file of triangles, with its axes, its size and what it is made of.

    units, metres_per_unit: of its coordinates, the latter with its scale.
    up: its axis that points up; None for that of its format.
    heading_rad: clockwise turn of its y axis (of -z where y is up) from north.
    centre: what stands at its position: the file's origin, or the middle of its box at its lowest point.
    material, materials: of all of it but some parts, and of these by their names.
    """

    path: Path
    units: str = "m"
    metres_per_unit: float = 1.0
    up: Literal["y", "z"] | None = None
    heading_rad: float = 0.0
    centre: Literal["origin", "box"] = "origin"
    material: str = "building"
    materials: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class StandingMesh:
    """A mesh at a place: east and north where it stands on the ground, otherwise with its height above the datum."""

    source: MeshSource
    position_m: tuple[float, ...]
    on_ground: bool = True


def upright(source: MeshSource, key: str) -> tuple[MeshPart, ...]:
    """Return a mesh file in metres, z up, rotated to its heading about its own origin.

    Raises InputFileError if it cannot be read or its size is implausible.
    """
    parts = read_mesh(source.path, f"{key}.path")
    turn = np.eye(3)
    if (source.up or up_axis(source.path)) == "y":
        turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    cos, sin = np.cos(source.heading_rad), np.sin(source.heading_rad)
    turn = source.metres_per_unit * np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ turn
    with np.errstate(over="ignore", invalid="ignore"):  # non-finite vertices are detected below
        placed = tuple(MeshPart(name=p.name, vertices=p.vertices @ turn.T, faces=p.faces) for p in parts)
        _check_size(placed, source, key)
    return placed


def about_box(parts: Sequence[MeshPart], source: MeshSource) -> tuple[MeshPart, ...]:
    """Return an upright mesh about its reference point: its origin or the middle of its base."""
    if source.centre == "origin":
        return tuple(parts)
    lower, upper = corners_of(parts)
    middle = np.array([*(lower + upper)[:2] / 2, lower[2]])
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
    """Return a note on a mesh farther from its origin than its size; empty for others."""
    lower, upper = place_m.min(axis=0), place_m.max(axis=0)
    distance_m = float(np.linalg.norm((lower + upper)[:2] / 2))
    if distance_m <= float(np.max(upper - lower)):
        return ""
    return f"; its file's origin lies {distance_m:,.0f} m from the middle of its box: set centre = 'box'"


def _check_size(parts: Sequence[MeshPart], source: MeshSource, key: str) -> None:
    lower, upper = corners_of(parts)
    largest = float(np.max(upper - lower))
    label = f"{key}.path = {shown(source.path)}"
    if not np.isfinite(largest):
        raise InputFileError(f"{label}: none of its vertices is finite; export the mesh again")
    if largest > LARGEST_M:
        raise InputFileError(
            f"{label}: is {largest / 1000:,.0f} km across in units = '{source.units}'; set units = 'mm' or a scale"
        )
    if largest < SMALLEST_M:
        message = f"{label}: is {largest * 1000:.3g} mm across in units = '{source.units}'; set units = 'km' or a scale"
        raise InputFileError(message)


def corners_of(parts: Sequence[MeshPart]) -> Float[np.ndarray, "2 3"]:
    """Return the lowest and highest corner of the bounding box of a mesh's faces; NaN without finite vertices."""
    referenced = np.concatenate([p.vertices[np.unique(p.faces)] for p in parts])
    referenced = referenced[np.isfinite(referenced).all(axis=1)]
    if len(referenced) == 0:
        return np.full((2, 3), np.nan)
    return np.array([referenced.min(axis=0), referenced.max(axis=0)])


def material_of_parts(parts: Sequence[MeshPart], source: MeshSource, key: str) -> list[str]:
    """Return the scenario's material of each part.

    Raises ScenarioError for a table of materials with names that the mesh does not have.
    """
    assigned = {name.removeprefix(SIONNA_PREFIX): material for name, material in source.materials.items()}
    part_names = [part.name.removeprefix(SIONNA_PREFIX) for part in parts]
    missing = sorted(set(assigned) - set(part_names))
    if missing:
        options = (
            ", ".join(shown(name) for name in sorted(set(part_names) - {""})) or "no names at all; use material alone"
        )
        message = f"the mesh has no {', '.join(shown(name) for name in missing)}; it has {options[:1000]}"
        raise ScenarioError.of(f"{key}.materials", message)
    return [assigned.get(name, source.material) for name in part_names]


def surfaces_of(mesh: RepairedMesh, materials: Sequence[str], name: str) -> tuple[Surface, ...]:
    """Return a mesh as surfaces: one each for the closed and open parts of each material, in order."""
    names = list(dict.fromkeys(materials))
    group_of_face = np.array([names.index(m) for m in materials])[mesh.owner] * 2 + mesh.two_sided
    surfaces = []
    for group in np.unique(group_of_face):
        kept_vertices, index = np.unique(mesh.faces[group_of_face == group], return_inverse=True)
        surfaces.append(
            Surface(
                name=f"{name}-{group}",
                vertices_m=mesh.vertices_m[kept_vertices],
                faces=index.reshape(-1, 3).astype(np.int64),
                material=names[group // 2],
                two_sided=bool(group % 2),
                divided=True,
            )
        )
    return tuple(surfaces)


@dataclass(frozen=True, kw_only=True)
class ReadObject:
    """A repaired mesh about its own origin, with the scenario's material of each of its parts."""

    mesh: RepairedMesh
    materials: list[str]


def build_objects(items: Sequence[StandingMesh], ground_m: Heights, datum_m: float) -> tuple[Surface, ...]:
    """Return objects as surfaces, one or two per material of each; copies of one file are read once.

    items: the objects, in the order of the scenario.
    ground_m: height of the ground at horizontal positions; NaN beyond the terrain.
    datum_m: height of the local origin in the heights of the terrain.

    Raises ScenarioError, InputFileError if one stands beyond the terrain, names materials that its file does not have,
        or its file cannot be used.
    """
    cache: dict[str, ReadObject] = {}
    surfaces: list[Surface] = []
    for index, item in enumerate(items):
        key = repr(item.source)
        if key not in cache:
            cache[key] = _read(item.source, f"objects.{index}")
        surfaces += _placed(item, index, cache[key], ground_m, datum_m)
    return tuple(surfaces)


def _read(source: MeshSource, key: str) -> ReadObject:
    parts = about_box(upright(source, key), source)
    materials = material_of_parts(parts, source, key)
    return ReadObject(mesh=repair(parts, f"{key}.path = {shown(source.path)}"), materials=materials)


def _placed(item: StandingMesh, index: int, read: ReadObject, ground_m: Heights, datum_m: float) -> tuple[Surface, ...]:
    mesh, key = read.mesh, f"objects.{index}.position_m"
    east, north, *height = item.position_m
    kept_vertices = mesh.vertices_m[np.unique(mesh.faces)]
    if item.on_ground:
        ground = float(np.min(ground_m(_under(kept_vertices[:, :2]) + np.array([east, north]))))
        if not np.isfinite(ground):
            box = box_text(kept_vertices + np.array([east, north, 0.0])).rsplit(", z", 1)[0]
            message = (
                f"the object at {item.position_m}, {box}, extends beyond the terrain; move it or enlarge the terrain"
                f"{_far_from_origin(kept_vertices)}"
            )
            raise ScenarioError.of(key, message)
        lift_m = ground - float(kept_vertices[:, 2].min())
    else:
        lift_m = height[0] - datum_m
    placed = replace(mesh, vertices_m=mesh.vertices_m + np.array([east, north, lift_m]))
    check_reach(placed.vertices_m[np.unique(placed.faces)], key, item.source.path)
    return surfaces_of(placed, read.materials, f"object-{index}")


def check_reach(place_m: Float[np.ndarray, "n 3"], key: str, path: Path) -> None:
    """Reject a mesh so far from the local origin that float32 distorts its shape.

    Raises ScenarioError for the key of its position.
    """
    farthest = float(np.abs(place_m).max())
    if farthest > LARGEST_M:
        message = (
            f"{shown(path)} lies up to {farthest / 1000:,.0f} km from the local origin, {box_text(place_m)}; place it "
            "nearer, set centre = 'box', or, if its coordinates are those of a map, give terrain.crs of a mesh terrain"
        )
        raise ScenarioError.of(key, message)


def _under(plan_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "k 2"]:
    """Return points within the convex hull of a mesh in plan: its corners, and samples inside."""
    lower, upper = plan_m.min(axis=0), plan_m.max(axis=0)
    fraction = np.linspace(0.0, 1.0, GROUND_SAMPLES)
    grid = np.stack(np.meshgrid(*(a + fraction * (b - a) for a, b in zip(lower, upper, strict=True))), axis=-1).reshape(
        -1, 2
    )
    try:
        hull = ConvexHull(plan_m)
    except QhullError:  # a line in plan, or a point
        return np.unique(plan_m, axis=0)
    in_hull = np.all(grid @ hull.equations[:, :2].T + hull.equations[:, 2] <= 1e-9, axis=1)
    return np.concatenate([plan_m[hull.vertices], grid[in_hull]])


AZIMUTH, ELEVATION, RCS = "azimuth_deg", "elevation_deg", "rcs_dbsm"
REMEDY = f"give a CSV file with the columns {AZIMUTH},{RCS}, and {ELEVATION} if it depends on that"


def read_rcs(path: Path) -> RcsTable:
    """Return the table in a file; raises InputFileError for any other file."""
    columns_of_file = {AZIMUTH: None, ELEVATION: 0.0, RCS: None}
    azimuth, elevation, rcs_db = np.array(read_numbers(path, "rcs_table", columns_of_file, REMEDY)[1])
    reason = ""
    if np.ptp(azimuth) >= 360 or np.abs(elevation).max() > 90 or np.abs(rcs_db).max() > 200:
        reason = "azimuths cover a turn or more (leave out the last), elevations exceed 90, or levels 200 dB"
    columns, column = np.unique(azimuth, return_inverse=True)
    heights, row = np.unique(elevation, return_inverse=True)
    if len(columns) * len(heights) != len(rcs_db) or len(set(zip(row, column, strict=True))) != len(rcs_db):
        reason = reason or "there is not one row for each azimuth at each elevation"
    if reason:
        raise InputFileError(f"rcs_table {shown(path)}: {reason}; {REMEDY}")
    rcs_m2 = np.empty((len(heights), len(columns)))
    rcs_m2[row, column] = 10 ** (rcs_db / 10)
    return RcsTable(azimuth_rad=np.deg2rad(columns), elevation_rad=np.deg2rad(heights), rcs_m2=rcs_m2)


# Over a face of side s at range r the two-way phase error of the plane-wave approximation is pi s^2 / (2 wavelength r)
# at its corners: pi / 8 at this range.
NEAREST_M = 10.0
MAX_FACES = 200_000


def body_of(source: MeshSource, key: str, wavelength_m: float, reflectivity: float = 1.0) -> Body:
    """Return the body of a target.

    reflectivity: of its surface, power over that of a perfect conductor.

    Raises InputFileError if the mesh cannot be used.
    Raises ScenarioError if it is so large that it would have too many faces.
    """
    mesh = repair(upright(source, key), f"{key}.path = {shown(source.path)}")
    longest_m = np.sqrt(wavelength_m * NEAREST_M / 4)
    corner = mesh.vertices_m[mesh.faces]
    side_m = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    # Halving all sides makes four faces of one.
    halvings = np.ceil(np.log2(np.maximum(side_m / longest_m, 1.0)))
    needed = float((4.0**halvings).sum())
    if needed > MAX_FACES:
        message = (
            f"is of {needed:,.0f} faces of at most {100 * longest_m:.0f} cm, more than {MAX_FACES:,}; give a smaller "
            "or simpler mesh, or set units"
        )
        raise ScenarioError.of(f"{key}.path", message)
    import trimesh

    vertices, faces, owner = trimesh.remesh.subdivide_to_size(
        mesh.vertices_m, mesh.faces, longest_m, max_iter=64, return_index=True
    )
    return Body(
        vertices_m=vertices,
        faces=faces.astype(np.int64),
        two_sided=mesh.two_sided[owner],
        reflectivity=reflectivity,
    )


# Largest step, and largest number of steps, in which a path follows the ground.
STEP_M, MAX_STEPS = 2.0, 20_000


def way_over(
    waypoints_m: Sequence[tuple[float, float]],
    height_m: float,
    speed_mps: float,
    key: str,
    standing_m: Heights,
    *,
    closed: bool,
) -> Way:
    """Return a way along waypoints, at a height above the ground and a speed; ScenarioError where there is none."""
    waypoints = np.array([*waypoints_m, *(waypoints_m[:1] if closed else [])])
    length_m = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    step_m = max(STEP_M, float(length_m.sum()) / MAX_STEPS)
    pieces = [
        np.linspace(a, b, max(1, int(np.ceil(leg / step_m))), endpoint=False)
        for a, b, leg in zip(waypoints, waypoints[1:], length_m, strict=False)
    ]
    corner = np.vstack([*pieces, waypoints[-1:]])
    height = standing_m(corner)
    if not np.all(np.isfinite(height)):
        message = "its path leaves the terrain; keep it over the terrain, or enlarge the terrain"
        raise ScenarioError.of(f"{key}.waypoints_m", message)
    return Way(corner_m=np.column_stack([corner, height + height_m]), speed_mps=speed_mps, closed=closed)
