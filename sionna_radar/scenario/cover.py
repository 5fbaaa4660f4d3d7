"""Tables of land cover and vegetation: `[terrain]` covers and `[[vegetation]]`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from sionna_radar.scenario.table import Conflicts, InputPath, Point2, Positive, Real, Table


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

    polygon_m: Annotated[tuple[Point2, ...], Field(min_length=3)]
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


class VegetationTable(Table):
    """A stand of plants: a layer on the ground that returns an echo from all of its depth and dims what lies under it.

    Both values are of the whole stand, gaps included; the wind turns the phases of the plants (`weather.wind_mps`).
    Measured millimetre-wave extinction is for instance in Recommendation ITU-R P.833, and by Jones, Espeland and
    Violette (NTIA, conifers in October 1987, 9.6 to 96.1 GHz).
    """

    polygon_m: Annotated[tuple[Point2, ...], Field(min_length=3)] | None = None
    """Outline of the stand on the map: corners in order, each in the coordinates of the scenario. Where stands overlap
    the last one counts. With `path` it may be omitted: the stand then covers the whole raster."""
    height_m: Annotated[Positive, Field(le=100)] | None = None
    """Height of the top of the stand above the ground."""
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
    extinction_db_per_m: Annotated[Real, Field(ge=0, le=100)]
    """One-way attenuation of power, in dB per metre of path."""
    backscatter_db_per_m: Annotated[Real, Field(ge=-100, le=30)]
    """Radar cross-section per cubic metre, in dB over a square metre."""

    def _conflicts(self) -> Conflicts:
        if (self.height_m is None) == (self.path is None):
            yield "height_m", "give either height_m or path, not both and not neither"
        if self.polygon_m is None and self.path is None:
            yield "polygon_m", "missing; give the corners of the stand's outline"
        if self.path is None and self.changed("least_height_m"):
            yield "least_height_m", f"{self.least_height_m:g} has no effect without path; give it"
        for name in () if self.of_cloud else self.changed("classes", "cloud_spacing_m"):
            yield name, "has no effect without a point cloud; remove it, or give one as path"

    @property
    def of_cloud(self) -> bool:
        """Whether the heights come from a point cloud."""
        return self.path is not None and self.path.suffix.lower() in (".las", ".laz")
