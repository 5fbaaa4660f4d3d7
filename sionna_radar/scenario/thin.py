"""Tables `[[wires]]`, `[[poles]]` and `[[fences]]`: obstacles that are thin against the beam."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field

from sionna_radar.scenario.materials import Medium
from sionna_radar.scenario.table import (
    MAX_CORNERS,
    Conflicts,
    InputPath,
    NonNegative,
    Point2,
    Point3,
    Positive,
    Real,
    Table,
)

Diameter = Annotated[Positive, Field(le=5000)]
# The tallest mast and tower are 646 and 828 m high.
Tall = Annotated[Positive, Field(le=1000)]
# Thickest conductor with strands: the thickest of power lines have 60 mm.
MAX_STRANDED_MM = 100.0


class ThinTable(Table):
    """What thin obstacles have in common.

    Their echoes add up along their lengths, with the field of a conducting cylinder of any thickness (series solution).
    They hide nothing, and are obstacles, not part of the surface that a DEM is compared with.
    """

    medium: Medium | None = None
    """Medium of the surface, for its reflection of a wave from in front; default: metal. The echo of its back wall, if
    the wave reaches that, is left out."""


class WireTable(ThinTable):
    """A wire, or several side by side, between points or along the lines of a vector file, such as a power line."""

    points_m: Annotated[tuple[Point3, ...], Field(max_length=MAX_CORNERS)] = ()
    """Points that hold the wire: east, north, and height."""
    heights: Literal["ground", "datum"] = "ground"
    """What the heights count from: the ground under each point, or the datum of the terrain (the local origin)."""
    path: InputPath | None = None
    """Vector file of lines, instead of `points_m`: GeoJSON, GeoPackage or Shapefile, such as OpenStreetMap's power
    lines, with a support at each vertex."""
    layer: str | None = None
    """Layer of a GeoPackage that has several."""
    height: str | None = None
    """Attribute of the file with the height above ground: metres, or text such as "12", "12.5 m" or "40 ft"."""
    height_m: Tall | None = None
    """Height above ground of lines without the attribute. Default: they are left out, with a warning."""
    pylons: Literal["none", "pole", "lattice"] = "none"
    """Supports under every point, as high as the highest wire there: none, round poles, or lattice masts as in
    `[[poles]]`."""
    pylon_width_m: Tall | None = None
    """Diameter of pole supports (default 0.3), or width of lattice masts at their feet (default a sixth of the
    height)."""
    sag_m: NonNegative = 0.0
    """Depth of the wire in the middle of each span below the straight line between its ends."""
    diameter_mm: Diameter
    """Diameter of the wire over all of its strands."""
    strands: Annotated[int, Field(strict=True, ge=3, le=200)] | None = None
    """Number of strands in the outer layer of a stranded conductor, whose twist returns lobes beside the broadside."""
    lay_mm: Annotated[Positive, Field(le=10_000)] | None = None
    """Length in which the strands go once round the conductor."""
    count: Annotated[int, Field(strict=True, ge=1, le=100)] = 1
    """Number of wires side by side."""
    spacing_m: Tall | None = None
    """Distance between neighbouring wires."""
    arrangement: Literal["level", "upright"] = "level"
    """Whether the wires lie beside each other, about the points, or above each other, the lowest at the points."""

    def _conflicts(self) -> Conflicts:
        if (self.path is None) == (len(self.points_m) == 0):
            yield "points_m", "give one of points_m and path, not both and not neither"
        if self.path is None and len(self.points_m) < 2:
            yield "points_m", "has one point; give two or more"
        if any(a == b for a, b in pairwise(self.points_m)):
            yield "points_m", "two successive points are equal; remove one"
        of_file = [key for key in ("layer", "height", "height_m") if getattr(self, key) is not None]
        if self.path is None and of_file:
            yield of_file[0], "goes with path; remove it, or give the heights in points_m"
        if self.path is not None and not (self.height or self.height_m):
            yield "height_m", "missing; give metres above ground, or an attribute of the file as height"
        if self.path is not None and self.heights == "datum":
            yield "heights", "'datum' goes with points_m; lines of a file have heights above ground"
        if (self.strands is None) != (self.lay_mm is None):
            yield "lay_mm", "goes with strands; give both or none"
        if self.strands is not None and self.diameter_mm > MAX_STRANDED_MM:
            message = f"must be at most {MAX_STRANDED_MM:g} of a conductor with strands, not {self.diameter_mm:g}"
            yield "diameter_mm", message
        if self.lay_mm is not None and self.lay_mm < self.diameter_mm:
            yield "lay_mm", "is shorter than the conductor is thick; give the length of one turn of a strand"
        if (self.count > 1) != (self.spacing_m is not None):
            yield "spacing_m", "goes with a count of two or more; give both or none"
        if self.pylon_width_m is not None and self.pylons == "none":
            yield "pylon_width_m", "has no effect without pylons; set pylons, or remove it"


class PoleTable(ThinTable):
    """A pole, a lattice mast of thin members, or a dry branch."""

    position_m: Point2
    """Position of the foot, east and north."""
    base_m: Annotated[NonNegative, Field(le=1000)] = 0.0
    """Height of the foot above the ground."""
    length_m: Tall
    """Length: of an upright one, its height."""
    diameter_mm: Diameter
    """Diameter of the pole, of the members of a mast, or of the branch with its twigs."""
    shape: Literal["pole", "lattice", "branch"] = "pole"
    """A single cylinder; a square lattice mast with four legs and crossed braces; or a limb with six twigs."""
    width_m: tuple[Tall, Tall] | None = None
    """Widths of a lattice mast at its foot and at its top. Default: a sixth and a twentieth of its length."""
    tilt_deg: Annotated[Real, Field(ge=0, le=180)] = 0.0
    """Tilt from the vertical, of a pole or a branch."""
    heading_deg: Real = 0.0
    """Direction of the tilt, clockwise from north."""

    def _conflicts(self) -> Conflicts:
        if self.width_m is not None and self.shape != "lattice":
            yield "width_m", "goes with shape = 'lattice'; remove it"
        if self.tilt_deg != 0 and self.shape == "lattice":
            yield "tilt_deg", "a lattice mast stands upright; remove it"


class FenceTable(ThinTable):
    """A fence: posts along a line with wires between them."""

    points_m: Annotated[tuple[Point2, ...], Field(min_length=2, max_length=MAX_CORNERS)]
    """Corners of the line, east and north."""
    height_m: Tall
    """Height of the posts, and of the highest wire above ground."""
    wires: Annotated[int, Field(strict=True, ge=0, le=50)] = 3
    """Number of wires, evenly spaced from the ground to the top."""
    diameter_mm: Diameter = 2.5
    """Diameter of the wires."""
    post_spacing_m: Positive = 3.0
    """Largest distance between neighbouring posts."""
    post_diameter_mm: Diameter = 80.0
    """Diameter of the posts."""

    def _conflicts(self) -> Conflicts:
        if any(a == b for a, b in pairwise(self.points_m)):
            yield "points_m", "two successive points are equal; remove one"
