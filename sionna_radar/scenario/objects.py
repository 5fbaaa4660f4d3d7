"""Tables `[[buildings]]`, `[[objects]]`, `[[footprints]]` and `[[targets]]`."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field

from sionna_radar.scenario.table import Conflicts, InputPath, NonNegative, Point2, Positive, Real, Table
from sionna_radar.scenario.terrain import MeshFile, MeshShape


class Building(Table):
    """A box that stands on the lowest ground under it; heading 0 puts its length along north."""

    position_m: Point2
    """Centre of the box: east and north."""
    size_m: tuple[Positive, Positive, Positive]
    """Length, width and height of the box."""
    heading_deg: Real = 0.0
    """Heading of the box's length, clockwise from north."""
    material: str = "building"
    """Material of the walls and the roof."""


class MeshObject(MeshFile):
    """A mesh that stands in the scene: a pylon, a bridge, a tree, a house. It may overhang."""

    position_m: Annotated[tuple[Real, ...], Field(min_length=2, max_length=3)]
    """Position of the file's origin, or of the middle of its bounding box (`centre`). With `on_ground` it is east and
    north, and the lowest point of the mesh stands on the lowest ground within its outline; otherwise add a third
    number, the height of that point in the heights of the terrain (above its datum where it has one)."""
    on_ground: bool = Field(default=True, strict=True)
    """Whether the mesh stands on the ground."""

    def _conflicts(self) -> Conflicts:
        if self.on_ground and len(self.position_m) == 3:
            yield "position_m", "has a third number, the height; remove it, or set on_ground = false"
        if not self.on_ground and len(self.position_m) == 2:
            yield "position_m", "on_ground = false needs a third number, the height; add it"


class Footprints(Table):
    """Buildings from the outlines of a vector file: GeoJSON, GeoPackage or Shapefile, such as OpenStreetMap's.

    Outlines are transformed from the file's CRS; over terrain without a georeference they are local metres.
    Each stands with its base on the lowest ground along its outline, and its height counts from there, as that of
    `[[buildings]]` does; courtyards stay open. Outlines that lie beyond the survey's reach are not built, and those
    beyond the terrain are left out with a warning.
    """

    path: InputPath
    """Vector file of the outlines."""
    layer: str | None = None
    """Layer of a GeoPackage that has several."""
    height: str | None = None
    """Attribute with the height: metres, or text as in OpenStreetMap, such as "12", "12.5 m" or "40 ft"."""
    levels: str | None = None
    """Attribute with the number of storeys, each of `level_height_m`; used where the height is unknown."""
    level_height_m: Positive = 3.0
    """Height of a storey."""
    height_m: Positive | None = None
    """Height of outlines without height attributes. Default: they are omitted."""
    material: str = "building"
    """Material of walls and roofs."""
    material_attribute: str | None = None
    """Attribute with the material of a building, such as OpenStreetMap's building:material."""
    materials: dict[str, str] = {}
    """Material of the scenario for each value of `material_attribute`; any other value takes `material`."""

    def _conflicts(self) -> Conflicts:
        if self.height is None and self.levels is None and self.height_m is None:
            yield "height_m", "missing; give metres, or an attribute of the file as height or levels"
        if bool(self.materials) != (self.material_attribute is not None):
            yield "materials", "goes with material_attribute; give both or none"


HubOffset = Annotated[Real, Field(ge=-1000, le=1000)]


class RotorTable(Table):
    """Rotating blades of a target, such as a propeller; each blade is a row of points along its length."""

    offset_m: tuple[HubOffset, HubOffset, HubOffset] = (0.0, 0.0, 0.0)
    """Offset of the hub from the target: forward, right, and up."""
    axis: Literal["up", "forward", "right"] = "up"
    """Axis about which the blades turn."""
    radius_m: Annotated[Positive, Field(le=100)]
    """Radius of the blade tips."""
    rotation_rpm: Annotated[Real, Field(ge=-1e6, le=1e6)]
    """Rotation rate; a negative one turns the other way."""
    blades: Annotated[int, Field(strict=True, ge=1, le=16)] = 2
    """Number of blades."""
    points: Annotated[int, Field(strict=True, ge=1, le=64)] = 8
    """Number of scattering points along each blade."""
    rcs_dbsm: Annotated[Real, Field(ge=-100, le=100)]
    """Mean radar cross-section of a blade, in dB over a square metre."""


class TargetMesh(MeshShape):
    """The shape of a target, whose echo is computed by physical optics, face by face.

    It occludes what lies behind it; faces behind others return nothing. Edges, creeping waves and reflections between
    faces are left out. Its own origin stands at the target's position.
    """

    reflectivity_db: Annotated[Real, Field(ge=-100, le=0)] = 0.0
    """Power reflectivity of the surface, relative to a perfect conductor."""


class PointTarget(Table):
    """A point target of given mean radar cross-section, constant or by Swerling's cases, or a body of given shape.

    It rests above the ground, or moves along waypoints at a constant speed; a point occludes nothing.
    """

    position_m: Point2
    """Position, east and north; the start of its path if the target moves."""
    height_m: Annotated[NonNegative, Field(le=100_000)] = 0.0
    """Height above the ground."""
    rcs_dbsm: Annotated[Real, Field(ge=-100, le=100)] | None = None
    """Mean radar cross-section, in dB over a square metre."""
    rcs_table: InputPath | None = None
    """CSV file of the radar cross-section, instead of `rcs_dbsm`, with the columns azimuth_deg,rcs_dbsm and optionally
    elevation_deg: by the direction from which the target is seen, clockwise from its front, and above its horizon."""
    mesh: TargetMesh | None = None
    """Shape of the target, instead of `rcs_dbsm` and `rcs_table`."""
    swerling: Annotated[int, Field(strict=True, ge=0, le=4)] = 0
    """Swerling case of the fluctuation, 0 (constant) to 4."""
    waypoints_m: tuple[Point2, ...] = ()
    """Waypoints, east and north, to which the target moves one after another, at its height above the ground."""
    speed_mps: Annotated[Positive, Field(le=1e4)] | None = None
    """Speed along the waypoints."""
    closed: bool = Field(default=False, strict=True)
    """Whether the path closes and is repeated. Default: the target stops at the last waypoint."""
    heading_deg: Real = 0.0
    """Heading of the front of a target at rest, clockwise from north; a moving target looks ahead."""
    rotors: tuple[RotorTable, ...] = ()
    """Rotating blades of the target."""

    def _conflicts(self) -> Conflicts:
        if sum(source is not None for source in (self.rcs_dbsm, self.rcs_table, self.mesh)) != 1:
            yield "rcs_dbsm", "give one of rcs_dbsm, rcs_table and mesh, not several and not none"
        if self.mesh is not None and self.swerling != 0:
            yield "swerling", "has no effect on a mesh, which fluctuates by its shape; remove one"
        if bool(self.waypoints_m) != (self.speed_mps is not None):
            yield "speed_mps", "motion needs both waypoints_m and speed_mps; give both, or neither"
        if self.closed and not self.waypoints_m:
            yield "closed", "has no effect without waypoints_m; give them"
        if self.waypoints_m and self.heading_deg != 0:
            yield "heading_deg", "has no effect on a moving target, which looks ahead; remove it"
        corners = (self.position_m, *self.waypoints_m)
        if any(a == b for a, b in pairwise(corners)) or (self.closed and corners[-1] == corners[0]):
            yield "waypoints_m", "two successive waypoints are equal; remove one"
