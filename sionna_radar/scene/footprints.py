"""Buildings: extruded from the outlines of a vector file, thousands at a time, and boxes that stand on the ground."""

import logging
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.foundation.errors import InputFileError, Problem, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.scenario.objects import Building, Footprints
from sionna_radar.scene.model import Surface
from sionna_radar.scene.vector_file import Polygons, read_polygons

logger = logging.getLogger("sionna_radar")

# The ground is looked up at least this often along an outline.
GROUND_STEP_M = 5.0
MAX_STEPS = 2000  # but no more often
# Higher than any building, and lower than any.
HIGHEST_M, LOWEST_M = 2000.0, 0.01
FOOT_M, INCH_M = 0.3048, 0.0254
METRES = re.compile(r"\s*([0-9]*\.?[0-9]+)\s*(m|metres|meters|ft|feet|')?\s*")
FEET_AND_INCHES = re.compile(r"\s*([0-9]+)\s*'\s*([0-9]*\.?[0-9]+)\s*\"\s*")


def height_of(value: Any) -> float:
    """Return the metres that an attribute states, as OpenStreetMap writes heights; NaN where it states none.

    A number, or text: "12", "12.5 m", "12,5", "40 ft", 40' or 7'6".
    """
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, str) or len(value) > 100:
        return np.nan
    inches = FEET_AND_INCHES.fullmatch(value)
    if inches:
        return float(inches[1]) * FOOT_M + float(inches[2]) * INCH_M
    found = METRES.fullmatch(value.replace(",", "."))
    if not found:
        return np.nan
    return float(found[1]) * (FOOT_M if found[2] in ("ft", "feet", "'") else 1.0)


def build_footprints(
    table: Footprints,
    index: int,
    frame: MapFrame | None,
    window_m: tuple[float, float, float, float],
    ground_m: Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]],
) -> tuple[Surface, ...]:
    """Return all buildings of a file that the survey can see, as one surface of each material.

    Each stands on the lowest ground along its outline, and its roof is level. It has no underside.

    Parameters
    ----------
    table, index:
        The file and its number in the scenario.
    frame, window_m:
        Place of the local frame on the map, and the extent that the survey can see (west, south, east, north).
    ground_m:
        Height of the ground at horizontal positions; NaN beyond the terrain.

    Raises
    ------
    ScenarioError, InputFileError
        The file cannot be used, or none of its buildings stands on the terrain.

    """
    import shapely

    key, name = f"footprints.{index}", f"footprints.{index}.path = {shown(table.path)}"
    attributes = [
        attribute for attribute in (table.height, table.levels, table.material_attribute) if attribute is not None
    ]
    found = read_polygons(table.path, key, list(dict.fromkeys(attributes)), frame, window_m, table.layer)
    if len(found.shape) == 0:
        logger.warning("%s: has no polygon within the survey's reach", name)
        return ()
    height = _heights(table, found.values, len(found.shape))
    shape = shapely.orient_polygons(shapely.remove_repeated_points(found.shape, 1e-3))
    base = _lowest_ground(shape, ground_m)
    tall = (height >= LOWEST_M) & (height <= HIGHEST_M)
    _tell(found, tall, np.isfinite(base), name)
    if not tall.any():
        message = (
            f"{name}: none of its {len(shape):,} outlines has a height from {LOWEST_M:g} to {HIGHEST_M:g} m; give "
            "height_m in metres, or the attribute with it"
        )
        raise InputFileError(message)
    keep = tall & np.isfinite(base)
    if not keep.any():
        message = f"none of its {len(shape):,} outlines stands on the terrain; check its place and CRS"
        raise ScenarioError([Problem(f"{key}.path", message)])
    material = _materials(table, found.values, len(shape), key)
    surfaces: list[Surface] = []
    for name in dict.fromkeys(material[keep]):
        own = keep & (material == name)
        vertices, faces = _extruded(shape[own], base[own], height[own])
        number = f"{index}-{len(surfaces)}" if surfaces else f"{index}"
        surfaces.append(Surface(name=f"footprints-{number}", vertices_m=vertices, faces=faces, material=str(name)))
    return tuple(surfaces)


def _materials(table: Footprints, values: dict[str, np.ndarray], count: int, key: str) -> np.ndarray:
    """Return the material of each polygon.

    Raises ScenarioError for values of which no polygon is.
    """
    if table.material_attribute is None:
        return np.full(count, table.material, dtype=object)
    given = ["" if value is None else str(value) for value in values[table.material_attribute]]
    unknown = sorted(set(table.materials) - set(given))
    if unknown:
        known = ", ".join(shown(name) for name in sorted(set(given) - {""})[:50]) or "none at all"
        message = f"no outline has {', '.join(map(shown, unknown))} as {table.material_attribute}; there are {known}"
        raise ScenarioError([Problem(f"{key}.materials", message)])
    return np.array([table.materials.get(value, table.material) for value in given], dtype=object)


def _tell(found: Polygons, tall: Bool[np.ndarray, " polygon"], stands: Bool[np.ndarray, " polygon"], name: str) -> None:
    """Log what is left out and what was repaired, with the counts."""
    left_out = {
        "no polygons": found.dropped,
        "without a height that a building can have": int(np.count_nonzero(~tall)),
        "beyond the terrain": int(np.count_nonzero(tall & ~stands)),
    }
    said = ", ".join(f"{count:,} {what}" for what, count in left_out.items() if count)
    if said or found.repaired:
        message = "%s: left out %s, and repaired %s outlines, of %s"
        logger.warning(message, name, said or "none", f"{found.repaired:,}", f"{len(found.shape):,}")


def _heights(table: Footprints, values: dict[str, np.ndarray], count: int) -> Float[np.ndarray, " polygon"]:
    """Return the height of each polygon: its attribute, or its storeys', or that of all; NaN where there is none."""
    height = np.full(count, np.nan)
    if table.height is not None:
        height = np.array([height_of(value) for value in values[table.height]], dtype=np.float64)
    if table.levels is not None:
        levels = np.array([height_of(value) for value in values[table.levels]], dtype=np.float64)
        height = np.where(np.isfinite(height), height, levels * table.level_height_m)
    return height if table.height_m is None else np.where(np.isfinite(height), height, table.height_m)


def _lowest_ground(
    shape: np.ndarray, ground_m: Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]
) -> Float[np.ndarray, " polygon"]:
    """Return the lowest ground along each outline, NaN where part of it has none; one look-up for all outlines."""
    import shapely

    step_m = np.maximum(GROUND_STEP_M, shapely.length(shape) / MAX_STEPS)
    place, owner = shapely.get_coordinates(shapely.segmentize(shape, step_m), return_index=True)
    height = ground_m(place)
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
    last = np.append(np.diff(of_ring) > 0, True)
    corner, of_ring = corner[~last], of_ring[~last]  # the last corner of a ring is its first again
    owner, count = of_polygon[of_ring], len(corner)
    foot = np.column_stack([corner, base_m[owner]])
    eaves = np.column_stack([corner, (base_m + height_m)[owner]])
    sides = np.bincount(of_ring, minlength=len(ring))
    first = (np.cumsum(sides) - sides)[of_ring]
    a = np.arange(count)
    b = first + (a - first + 1) % sides[of_ring]
    walls = np.concatenate([np.column_stack([a, b, b + count]), np.column_stack([a, b + count, a + count])])
    ends = np.cumsum(sides)
    rings_before = np.searchsorted(of_polygon, np.arange(len(shape) + 1))
    roofs = []
    for number in range(len(shape)):
        own = ends[rings_before[number] : rings_before[number + 1]]
        start = own[0] - sides[rings_before[number]]
        # Coordinates about the building itself, for a triangulation that is as good far from the origin.
        plan = np.ascontiguousarray(corner[start : own[-1]] - corner[start])
        cut = mapbox_earcut.triangulate_float64(plan, (own - start).astype(np.uint32))
        roofs.append(cut.astype(np.int64).reshape(-1, 3) + start)
    roof = np.concatenate(roofs)
    east, north = np.moveaxis(corner[roof], 2, 0)
    left = (east[:, 1] - east[:, 0]) * (north[:, 2] - north[:, 0])
    down = left < (north[:, 1] - north[:, 0]) * (east[:, 2] - east[:, 0])
    roof[down] = roof[down][:, ::-1]
    return np.concatenate([foot, eaves]), np.concatenate([walls, roof + count])


def build_box(
    building: Building, index: int, ground_m: Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]
) -> Surface:
    """Return a building as a box: its base on the lowest ground in its outline, its height above that.

    Raises
    ------
    ScenarioError
        Part of the outline is outside the terrain.

    """
    length, width, height = building.size_m
    heading = np.deg2rad(building.heading_deg)
    along, across = np.array([np.sin(heading), np.cos(heading)]), np.array([np.cos(heading), -np.sin(heading)])
    share = np.linspace(-0.5, 0.5, 21)
    a, b = (grid.ravel()[:, None] for grid in np.meshgrid(share * length, share * width))
    base = float(np.min(ground_m(np.array(building.position_m) + a * along + b * across)))
    if not np.isfinite(base):
        message = f"the building at {building.position_m} extends beyond the terrain; move it or enlarge the terrain"
        raise ScenarioError([Problem(f"buildings.{index}.position_m", message)])
    place = np.eye(4)
    place[:2, 0], place[:2, 1] = across, along
    place[:3, 3] = [*building.position_m, base + height / 2]
    # It takes a tenth of a second to import, and most scenes have no boxes.
    import trimesh

    box = trimesh.creation.box(extents=(width, length, height), transform=place)
    return Surface(
        name=f"building-{index}",
        vertices_m=np.asarray(box.vertices, dtype=np.float64),
        faces=np.asarray(box.faces, dtype=np.int64),
        material=building.material,
    )
