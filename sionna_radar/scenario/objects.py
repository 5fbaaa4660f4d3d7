"""Objects in a scene besides the ground: `[[buildings]]`, `[[objects]]`, `[[footprints]]` and `[[targets]]`."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field

from sionna_radar.scenario.table import Conflicts, InputPath, NonNegative, Point2, Positive, Real, Table
from sionna_radar.scenario.terrain import MeshFile, MeshShape


class Building(Table):
    """A box that stands on the lowest ground under it; heading 0 puts its length along north."""

    position_m: Point2
    """of its middle."""
    size_m: tuple[Positive, Positive, Positive]
    """length, width and height."""
    heading_deg: Real = 0.0
    """of its length, clockwise from north."""
    material: str = "building"
    """of its walls and roof."""


class MeshObject(MeshFile):
    """A mesh that stands in the scene: a pylon, a bridge, a tree, a house. It may overhang."""

    position_m: Annotated[tuple[Real, ...], Field(min_length=2, max_length=3)]
    """place of the file's origin, or of the middle of its box (`centre`). With `on_ground`, east and north, and the
    lowest point of the mesh stands on the lowest ground in its outline; without it a third number, the height of that
    place, in the heights of the terrain (above its datum where it has one)."""
    on_ground: bool = Field(default=True, strict=True)
    """whether it stands on the ground."""

    def _conflicts(self) -> Conflicts:
        if self.on_ground and len(self.position_m) == 3:
            yield "position_m", "a third number is its height; remove it, or set on_ground = false"
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
    """the vector file."""
    layer: str | None = None
    """of a GeoPackage with several."""
    height: str | None = None
    """attribute with the height: metres, or text as in OpenStreetMap, such as "12", "12.5 m" or "40 ft"."""
    levels: str | None = None
    """attribute with the number of storeys, where that is not known, of `level_height_m` each."""
    level_height_m: Positive = 3.0
    """height of a storey."""
    height_m: Positive | None = None
    """height of all outlines for which the attributes say nothing; without it these are left out."""
    material: str = "building"
    """of walls and roofs."""
    material_attribute: str | None = None
    """attribute that says of what a building is, such as OpenStreetMap's building:material."""
    materials: dict[str, str] = {}
    """materials of the scenario by its values; others are of `material`."""

    def _conflicts(self) -> Conflicts:
        if self.height is None and self.levels is None and self.height_m is None:
            yield "height_m", "not given; give metres, or the attribute that has them as height or levels"
        if bool(self.materials) != (self.material_attribute is not None):
            yield "materials", "goes with material_attribute; give both or none"


class RotorTable(Table):
    """Blades that turn on a target: a propeller, a wheel. Each is a row of points along its length."""

    offset_m: tuple[Real, Real, Real] = (0.0, 0.0, 0.0)
    """of the hub from the target: forward, to the right, and up."""
    axis: Literal["up", "forward", "right"] = "up"
    """about which the blades turn."""
    radius_m: Annotated[Positive, Field(le=100)]
    """of the blades' tips."""
    rotation_rpm: Annotated[Real, Field(ge=-1e6, le=1e6)]
    """negative to turn the other way."""
    blades: Annotated[int, Field(strict=True, ge=1, le=16)] = 2
    """how many."""
    points: Annotated[int, Field(strict=True, ge=1, le=64)] = 8
    """in which each blade is divided."""
    rcs_dbsm: Annotated[Real, Field(ge=-100, le=100)]
    """mean radar cross-section of a blade, in dB over a square metre."""


class TargetMesh(MeshShape):
    """The shape of a target, about its position: what returns an echo by physical optics, face by face.

    It hides what lies behind it; faces behind others return nothing. Edges, creeping waves and reflections between
    faces are left out. Its own origin stands at the target's position.
    """

    reflectivity_db: Annotated[Real, Field(ge=-100, le=0)] = 0.0
    """of its surface, power over that of a perfect conductor."""


class PointTarget(Table):
    """A point of given mean radar cross-section, constant or by Swerling's cases, or a body, above the ground.

    It stands, or moves along waypoints at a constant speed; a point does not hide anything.
    """

    position_m: Point2
    """east and north; where its way begins."""
    height_m: NonNegative = 0.0
    """above the ground."""
    rcs_dbsm: Annotated[Real, Field(ge=-100, le=100)] | None = None
    """mean radar cross-section, in dB over a square metre."""
    rcs_table: InputPath | None = None
    """instead of it, a CSV with the columns azimuth_deg,rcs_dbsm and, if wanted, elevation_deg: by the direction from
    which the target is seen, clockwise from its front, and above its horizon."""
    mesh: TargetMesh | None = None
    """instead of both, its shape."""
    swerling: Annotated[int, Field(strict=True, ge=0, le=4)] = 0
    """case 0 (constant) to 4."""
    waypoints_m: tuple[Point2, ...] = ()
    """places to which it moves from there, one after another, at its height above the ground."""
    speed_mps: Annotated[Positive, Field(le=1e4)] | None = None
    """at which it moves."""
    closed: bool = Field(default=False, strict=True)
    """whether its way leads back to its beginning, again and again; without it, it stands at the last place."""
    heading_deg: Real = 0.0
    """of its front while it has no way, clockwise from north; on its way it looks ahead."""
    rotors: tuple[RotorTable, ...] = ()
    """blades that turn on it."""

    def _conflicts(self) -> Conflicts:
        if sum(source is not None for source in (self.rcs_dbsm, self.rcs_table, self.mesh)) != 1:
            yield "rcs_dbsm", "give one of rcs_dbsm, rcs_table and mesh, not several and not none"
        if self.mesh is not None and self.swerling != 0:
            yield "swerling", "a mesh fluctuates by its shape alone; remove swerling or the mesh"
        if bool(self.waypoints_m) != (self.speed_mps is not None):
            yield "speed_mps", "a way needs both waypoints_m and speed_mps; give the other, or neither"
        if self.closed and not self.waypoints_m:
            yield "closed", "has no effect without waypoints_m; give them"
        if self.waypoints_m and self.heading_deg != 0:
            yield "heading_deg", "has no effect on a way, along which the target looks; remove it"
        corners = (self.position_m, *self.waypoints_m)
        if any(a == b for a, b in pairwise(corners)) or (self.closed and corners[-1] == corners[0]):
            yield "waypoints_m", "two places in a row are the same; leave one out"
