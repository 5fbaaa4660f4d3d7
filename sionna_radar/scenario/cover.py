"""Tables of land cover and vegetation: `[terrain]` covers and `[[vegetation]]`."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Annotated, Any, Literal

from pydantic import Field

from sionna_radar.foundation.input_file import shown
from sionna_radar.scenario.crops import CROPS, Crop, GrowthStage
from sionna_radar.scenario.table import Conflicts, InputPath, Outline, Point2, Positive, Real, Table, one_of


class MaterialField(Table):
    """A rectangle of another material on the terrain."""

    centre_m: Point2
    """Centre of the rectangle: east and north."""
    size_m: tuple[Positive, Positive]
    """Size of the rectangle along east and north."""
    material: str
    """Material of the rectangle; a name of the scenario's materials."""


class CoverPolygon(Table):
    """A polygon of another material on the terrain, by its corners in local metres."""

    polygon_m: Outline
    """Corners of the polygon in order, each in the coordinates of the scenario."""
    material: str
    """Material of the polygon; a name of the scenario's materials."""


class CoverRaster(Table):
    """A raster of class values, each mapped to a material: GeoTIFF, PNG or a grid."""

    path: InputPath
    """Raster file of land-cover classes."""
    classes: dict[str, str]
    """Material of each class value; ground of any other class keeps `terrain.material`. Over synthetic ground the
    raster's own coordinates are the local metres, and it has no CRS."""

    def _conflicts(self) -> Conflicts:
        if not self.classes:
            yield "classes", 'empty; map class values to materials, e.g. classes = {"1" = "forest"}'
        for key in self.classes:
            if not key.lstrip("-").isdecimal():
                yield f"classes.{key}", f"{key!r} is not a class value; give a whole number"

    @property
    def material_of_class(self) -> dict[int, str]:
        """Materials by class value."""
        return {int(key): name for key, name in self.classes.items()}


class CoverVector(Table):
    """Polygons with a class, each class mapped to a material: GeoJSON, GeoPackage or Shapefile.

    Where polygons overlap the later one in the file covers the earlier. They are transformed from the file's CRS; over
    terrain without a georeference they are local metres.
    """

    path: InputPath
    """Vector file of land-cover classes."""
    attribute: Annotated[str, Field(min_length=1)]
    """Attribute of the vector file that holds the class."""
    classes: dict[str, str]
    """Material of each class; ground of any other class, and beyond all polygons, keeps `terrain.material`."""
    layer: str | None = None
    """Layer of a GeoPackage that has several."""

    def _conflicts(self) -> Conflicts:
        if not self.classes:
            yield "classes", 'empty; map classes to materials, e.g. classes = { forest = "forest" }'


# Keys of `[[vegetation]]` that are of crops alone.
CROP_KEYS = (
    *("crop", "stage", "base_height_m", "leaf_area_index", "water_content", "leaf_thickness_mm", "row_spacing_m"),
    *("row_width_m", "row_heading_deg", "plant_spacing_m", "missing", "height_spread"),
)


class VegetationTable(Table):
    """A stand of plants: a layer on the ground that returns an echo from all of its depth and dims what lies under it.

    The plants of a crop (`kind = "crop"`) stand in rows, and its extinction and backscatter at the carrier follow from
    its leaves. Those of any other stand are of the whole stand, gaps included. The wind turns the phases of the plants
    (`weather.wind_mps`).
    Measured millimetre-wave extinction is for instance in Recommendation ITU-R P.833, and by Jones, Espeland and
    Violette (NTIA, conifers in October 1987, 9.6 to 96.1 GHz).
    """

    kind: Literal["stand", "crop"] = "stand"
    """Kind of plants: an even "stand" of given extinction and backscatter, or a "crop" in rows."""
    polygon_m: Outline | None = None
    """Outline of the stand on the map: corners in order, each in the coordinates of the scenario. Where stands overlap
    the last one counts. With `path` it may be omitted: the stand then covers the whole raster."""
    height_m: Annotated[Positive, Field(le=100)] | None = None
    """Height of the top of the stand above the ground. Default for a crop: that of its stage."""
    path: InputPath | None = None
    """File of canopy heights, instead of `height_m`: a raster in metres above the ground (a canopy-height model, as
    from lidar), or a point cloud, LAS or LAZ, whose highest points above the ground are taken. A file without a CRS is
    in local metres about its middle."""
    classes: Annotated[tuple[Annotated[int, Field(strict=True, ge=0, le=255)], ...], Field(min_length=1)] = (3, 4, 5)
    """Classes of the point cloud that are vegetation."""
    cloud_spacing_m: Annotated[Real, Field(ge=0.05, le=100)] = 1.0
    """Size of the cells in which the highest point of the cloud is taken."""
    least_height_m: Positive = 0.5
    """Least height of vegetation; where the canopy is lower, there is none."""
    extinction_db_per_m: Annotated[Real, Field(ge=0, le=100)] | None = None
    """One-way attenuation of power, in dB per metre of path. Default for a crop: from its leaves."""
    backscatter_db_per_m: Annotated[Real, Field(ge=-100, le=30)] | None = None
    """Radar cross-section per cubic metre, in dB over a square metre. Default for a crop: from its leaves."""
    light_extinction_db_per_m: Annotated[Real, Field(ge=0, le=100)] | None = None
    """One-way attenuation of a lidar's light, in dB per metre of path. Default: for a crop that of opaque leaves, half
    of their area per volume; for a stand extinction_db_per_m."""
    crop: Annotated[str, one_of(CROPS)] | None = None
    """Crop: "maize", "wheat", "vines", "orchard", "grass" or "forest_edge"."""
    stage: str | None = None
    """Growth stage of the crop, for example "flowering"; sets its height, leaf area and water where they are not
    given."""
    base_height_m: Annotated[Real, Field(ge=0, le=100)] | None = None
    """Height of the lowest leaves above the ground; below them is clear space. Default: that of the stage."""
    leaf_area_index: Annotated[Positive, Field(le=20)] | None = None
    """One-sided leaf area over the area of the field, the gaps between rows included. Default: that of the stage."""
    water_content: Annotated[Real, Field(ge=0, le=0.9)] | None = None
    """Mass of water over the mass of fresh leaf. Default: that of the stage."""
    leaf_thickness_mm: Annotated[Positive, Field(ge=0.01, le=5)] | None = None
    """Thickness of the leaves. Default: that of the crop."""
    row_spacing_m: Annotated[Positive, Field(ge=0.05, le=100)] | None = None
    """Distance between the middles of neighbouring rows; one row runs through the local origin. Default: that of the
    crop."""
    row_width_m: Annotated[Positive, Field(ge=0.01, le=100)] | None = None
    """Width of the foliage across its row; as wide as the spacing, the rows are closed. Default: that of the stage."""
    row_heading_deg: Annotated[Real, Field(ge=-360, le=360)] = 0.0
    """Heading of the rows, clockwise from north."""
    plant_spacing_m: Annotated[Positive, Field(ge=0.01, le=100)] | None = None
    """Distance between the plants of a row. Default: that of the crop."""
    missing: Annotated[Real, Field(ge=0, lt=1)] = 0.0
    """Share of the plants that are missing, at random places."""
    height_spread: Annotated[Real, Field(ge=0, le=0.5)] | None = None
    """Standard deviation of the heights of plants, over the height. Default: that of the crop."""

    def _conflicts(self) -> Conflicts:
        if self.kind == "crop":
            yield from self._conflicts_of_crop()
            return
        for name in self.changed(*CROP_KEYS):
            yield name, "has no effect on kind = 'stand'; remove it, or set kind = 'crop'"
        for name in ("extinction_db_per_m", "backscatter_db_per_m"):
            if getattr(self, name) is None:
                yield name, "missing; add it"
        if (self.height_m is None) == (self.path is None):
            yield "height_m", "give either height_m or path, not both and not neither"
        if self.polygon_m is None and self.path is None:
            yield "polygon_m", "missing; give the corners of the stand's outline"
        if self.path is None and self.changed("least_height_m"):
            yield "least_height_m", f"{self.least_height_m:g} has no effect without path; give it"
        for name in () if self.of_cloud else self.changed("classes", "cloud_spacing_m"):
            yield name, "has no effect without a point cloud; remove it, or give one as path"

    def _conflicts_of_crop(self) -> Conflicts:
        for name in self.changed("path", "classes", "cloud_spacing_m", "least_height_m"):
            yield name, "has no effect on kind = 'crop'; remove it, or set kind = 'stand'"
        if self.polygon_m is None:
            yield "polygon_m", "missing; give the corners of the field's outline"
        if self.crop is None:
            yield "crop", f"missing; give one of {', '.join(CROPS)}"
            return
        if self.stage not in CROPS[self.crop].stages:
            found = "missing" if self.stage is None else f"{shown(self.stage)} is no stage of {self.crop}"
            yield "stage", f"{found}; give one of {', '.join(CROPS[self.crop].stages)}"
            return
        width_m, spacing_m = self.grown.row_width_m, self.planted.row_spacing_m
        if width_m > spacing_m:
            message = (
                f"foliage {width_m:g} m wide in rows {spacing_m:g} m apart would cover {width_m / spacing_m:.0%} of "
                "the ground; give a row_width_m of at most row_spacing_m"
            )
            yield "row_spacing_m" if self.row_width_m is None else "row_width_m", message
        low_m, top_m = self.grown.base_height_m, self.grown.height_m
        if low_m >= top_m:
            message = (
                f"the lowest leaves, {low_m:g} m above the ground, are not below the tops at {top_m:g} m; lower "
                "base_height_m, or raise height_m"
            )
            yield "height_m" if self.base_height_m is None else "base_height_m", message

    @property
    def planted(self) -> Crop:
        """The crop as it is planted here; of a stand of kind "crop"."""
        assert self.crop is not None
        return replace(CROPS[self.crop], **self._stated_fields(Crop))

    @property
    def grown(self) -> GrowthStage:
        """The stage of the crop as it stands here; of a stand of kind "crop"."""
        assert self.crop is not None
        assert self.stage is not None
        return replace(CROPS[self.crop].stages[self.stage], **self._stated_fields(GrowthStage))

    def _stated_fields(self, kind: type) -> dict[str, Any]:
        values = {field.name: getattr(self, field.name, None) for field in fields(kind)}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def of_cloud(self) -> bool:
        """Whether the heights come from a point cloud."""
        return self.path is not None and self.path.suffix.lower() in (".las", ".laz")
