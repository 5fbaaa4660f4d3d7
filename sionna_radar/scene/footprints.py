"""Buildings extruded from the outlines of a vector file, and boxes on the ground."""

import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Heights
from sionna_radar.scene.model import Surface
from sionna_radar.scene.vector_file import Polygons, VectorQuery, read_polygons

logger = logging.getLogger("sionna_radar")

# Largest spacing of ground samples along an outline.
GROUND_STEP_M = 5.0
MAX_STEPS = 2000  # per outline
# Limits of plausible building heights.
HIGHEST_M, LOWEST_M = 2000.0, 0.01
FOOT_M, INCH_M = 0.3048, 0.0254
METRES = re.compile(r"\s*([0-9]*\.?[0-9]+)\s*(m|metres|meters|ft|feet|')?\s*")
FEET_AND_INCHES = re.compile(r"\s*([0-9]+)\s*'\s*([0-9]*\.?[0-9]+)\s*\"\s*")


@dataclass(frozen=True, kw_only=True)
class OutlineFile:
    """A vector file of the outlines of buildings.

    layer: None for its only one.
    height, levels: attributes with the height and with the number of storeys, of `level_height_m` each; None for none.
    height_m: of outlines for which the attributes say nothing; None leaves them out.
    material: of walls and roofs, but where `material_attribute` has a value of `materials`.
    """

    path: Path
    layer: str | None = None
    height: str | None = None
    levels: str | None = None
    level_height_m: float = 3.0
    height_m: float | None = None
    material: str = "building"
    material_attribute: str | None = None
    materials: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box on the ground: the place of its middle, its length, width and height, and the heading of its length."""

    position_m: tuple[float, float]
    size_m: tuple[float, float, float]
    heading_rad: float = 0.0
    material: str = "building"


def height_of(value: Any) -> float:
    """Parse a height attribute in OpenStreetMap's notation into metres; NaN without a valid value.

    A number, or text: "12", "12.5 m", "12,5", "40 ft", 40' or 7'6".
    """
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, str) or len(value) > 100:
        return np.nan
    inches = FEET_AND_INCHES.fullmatch(value)
    if inches:
        return float(inches[1]) * FOOT_M + float(inches[2]) * INCH_M
    match = METRES.fullmatch(value.replace(",", "."))
    if not match:
        return np.nan
    return float(match[1]) * (FOOT_M if match[2] in ("ft", "feet", "'") else 1.0)


def build_footprints(
    file: OutlineFile,
    index: int,
    frame: MapFrame | None,
    window_m: tuple[float, float, float, float],
    ground_m: Heights,
) -> tuple[Surface, ...]:
    """Return all buildings of a file visible to the survey, as one surface per material.

    Each stands on the lowest ground along its outline, with a level roof and without an underside.

    file, index: the file and its number in the scenario.
    frame, window_m: position of the local frame on the map, and the extent visible to the survey (west, south, east,
        north).
    ground_m: height of the ground at horizontal positions; NaN beyond the terrain.

    Raises ScenarioError, InputFileError if the file cannot be used, or none of its buildings stands on the terrain.
    """
    import shapely

    key, chosen = f"footprints.{index}", (file.height, file.levels, file.material_attribute)
    attributes = [name for name in dict.fromkeys(chosen) if name is not None]
    query = VectorQuery(
        path=file.path, layer=file.layer, key=key, attributes=attributes, frame=frame, window_m=window_m
    )
    polygons, name = read_polygons(query), query.name
    if len(polygons.shape) == 0:
        logger.warning("%s: has no polygon within the survey's reach", name)
        return ()
    height = _heights(file, polygons.values, len(polygons.shape))
    shape = shapely.orient_polygons(shapely.remove_repeated_points(polygons.shape, 1e-3))
    base = _lowest_ground(shape, ground_m)
    tall = (height >= LOWEST_M) & (height <= HIGHEST_M)
    _log_omissions(polygons, tall, np.isfinite(base), name)
    if not tall.any():
        raise InputFileError(
            f"{name}: none of its {len(shape):,} outlines has a height from {LOWEST_M:g} to {HIGHEST_M:g} m; give "
            "height_m in metres, or the attribute with it"
        )
    keep = tall & np.isfinite(base)
    if not keep.any():
        message = f"none of its {len(shape):,} outlines stands on the terrain; check its place and CRS"
        raise ScenarioError.of(f"{key}.path", message)
    material = _materials(file, polygons.values, len(shape), key)
    surfaces: list[Surface] = []
    for name in dict.fromkeys(material[keep]):
        selected = keep & (material == name)
        vertices, faces = _extruded(shape[selected], base[selected], height[selected])
        suffix = f"{index}-{len(surfaces)}" if surfaces else f"{index}"
        surfaces.append(Surface(name=f"footprints-{suffix}", vertices_m=vertices, faces=faces, material=str(name)))
    return tuple(surfaces)


def _materials(file: OutlineFile, values: dict[str, np.ndarray], count: int, key: str) -> np.ndarray:
    """Return the material of each polygon.

    Raises ScenarioError for values without a polygon.
    """
    if file.material_attribute is None:
        return np.full(count, file.material, dtype=object)
    attribute_values = ["" if value is None else str(value) for value in values[file.material_attribute]]
    missing = sorted(set(file.materials) - set(attribute_values))
    if missing:
        options = ", ".join(shown(name) for name in sorted(set(attribute_values) - {""})[:50]) or "none at all"
        message = f"no outline has {', '.join(map(shown, missing))} as {file.material_attribute}; there are {options}"
        raise ScenarioError.of(f"{key}.materials", message)
    return np.array([file.materials.get(value, file.material) for value in attribute_values], dtype=object)


def _log_omissions(
    polygons: Polygons, tall: Bool[np.ndarray, " polygon"], stands: Bool[np.ndarray, " polygon"], name: str
) -> None:
    omitted = {
        "no polygons": polygons.dropped,
        "without a height that a building can have": int(np.count_nonzero(~tall)),
        "beyond the terrain": int(np.count_nonzero(tall & ~stands)),
    }
    counts_text = ", ".join(f"{count:,} {reason}" for reason, count in omitted.items() if count)
    if counts_text or polygons.repaired:
        message = "%s: left out %s, and repaired %s outlines, of %s"
        logger.warning(message, name, counts_text or "none", f"{polygons.repaired:,}", f"{len(polygons.shape):,}")


def _heights(file: OutlineFile, values: dict[str, np.ndarray], count: int) -> Float[np.ndarray, " polygon"]:
    """Return the height of each polygon: from its attribute, its storeys, or the common height; NaN without any."""
    height = np.full(count, np.nan)
    if file.height is not None:
        height = np.array([height_of(value) for value in values[file.height]], dtype=np.float64)
    if file.levels is not None:
        levels = np.array([height_of(value) for value in values[file.levels]], dtype=np.float64)
        height = np.where(np.isfinite(height), height, levels * file.level_height_m)
    return height if file.height_m is None else np.where(np.isfinite(height), height, file.height_m)


def _lowest_ground(shape: np.ndarray, ground_m: Heights) -> Float[np.ndarray, " polygon"]:
    """Return the lowest ground along each outline, NaN if partly beyond the terrain; one look-up for all outlines."""
    import shapely

    step_m = np.maximum(GROUND_STEP_M, shapely.length(shape) / MAX_STEPS)
    points, owner = shapely.get_coordinates(shapely.segmentize(shape, step_m), return_index=True)
    height = ground_m(points)
    lowest = np.full(len(shape), np.inf)
    np.minimum.at(lowest, owner, np.where(np.isnan(height), -np.inf, height))
    return np.where(np.isfinite(lowest), lowest, np.nan)


def _extruded(
    shape: np.ndarray, base_m: Float[np.ndarray, " polygon"], height_m: Float[np.ndarray, " polygon"]
) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Return walls and roofs of polygons: outer rings counter-clockwise, inner ones clockwise.

    d---c   of each side a-b of a ring: a b c and a c d, seen from outside
    |   |
    a---b
    """
    import mapbox_earcut
    import shapely

    ring, of_polygon = shapely.get_rings(shape, return_index=True)
    corner, of_ring = shapely.get_coordinates(ring, return_index=True)
    closing = np.append(np.diff(of_ring) > 0, True)
    corner, of_ring = corner[~closing], of_ring[~closing]  # the last corner of a ring repeats its first
    owner, count = of_polygon[of_ring], len(corner)
    foot = np.column_stack([corner, base_m[owner]])
    eaves = np.column_stack([corner, (base_m + height_m)[owner]])
    sides = np.bincount(of_ring, minlength=len(ring))
    ring_start = (np.cumsum(sides) - sides)[of_ring]
    a = np.arange(count)
    b = ring_start + (a - ring_start + 1) % sides[of_ring]
    walls = np.concatenate([np.column_stack([a, b, b + count]), np.column_stack([a, b + count, a + count])])
    ends = np.cumsum(sides)
    rings_before = np.searchsorted(of_polygon, np.arange(len(shape) + 1))
    roofs = []
    for polygon in range(len(shape)):
        ring_ends = ends[rings_before[polygon] : rings_before[polygon + 1]]
        start = ring_ends[0] - sides[rings_before[polygon]]
        # Coordinates relative to the building, for a triangulation of equal precision far from the origin.
        plan = np.ascontiguousarray(corner[start : ring_ends[-1]] - corner[start])
        cut = mapbox_earcut.triangulate_float64(plan, (ring_ends - start).astype(np.uint32))
        roofs.append(cut.astype(np.int64).reshape(-1, 3) + start)
    roof = np.concatenate(roofs)
    east, north = np.moveaxis(corner[roof], 2, 0)
    cross_left = (east[:, 1] - east[:, 0]) * (north[:, 2] - north[:, 0])
    clockwise = cross_left < (north[:, 1] - north[:, 0]) * (east[:, 2] - east[:, 0])
    roof[clockwise] = roof[clockwise][:, ::-1]
    return np.concatenate([foot, eaves]), np.concatenate([walls, roof + count])


def build_box(box: Box, index: int, ground_m: Heights) -> Surface:
    """Return a box as a surface: its base on the lowest ground in its outline, its height above that.

    Raises ScenarioError if part of the outline is outside the terrain.
    """
    length, width, height = box.size_m
    heading = box.heading_rad
    along, across = np.array([np.sin(heading), np.cos(heading)]), np.array([np.cos(heading), -np.sin(heading)])
    offset = np.linspace(-0.5, 0.5, 21)
    a, b = (grid.ravel()[:, None] for grid in np.meshgrid(offset * length, offset * width))
    base = float(np.min(ground_m(np.array(box.position_m) + a * along + b * across)))
    if not np.isfinite(base):
        message = f"the building at {box.position_m} extends beyond the terrain; move it or enlarge the terrain"
        raise ScenarioError.of(f"buildings.{index}.position_m", message)
    transform = np.eye(4)
    transform[:2, 0], transform[:2, 1] = across, along
    transform[:3, 3] = [*box.position_m, base + height / 2]
    # Slow to import (0.1 s), and most scenes have no boxes.
    import trimesh

    mesh = trimesh.creation.box(extents=(width, length, height), transform=transform)
    return Surface(
        name=f"building-{index}",
        vertices_m=np.asarray(mesh.vertices, dtype=np.float64),
        faces=np.asarray(mesh.faces, dtype=np.int64),
        material=box.material,
    )
