"""What lies on the ground: rectangles, polygons, and a raster of classes, each with its material."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from sionna_radar.scenario.table import InputPath, Point2, Positive, Table, refuse


class MaterialField(Table):
    """A rectangle of another material on the terrain.

    centre_m: of the rectangle: east and north.
    size_m: of the rectangle along east and north.
    material: on it; a name of the scenario's materials.
    """

    centre_m: Point2
    size_m: tuple[Positive, Positive]
    material: str


class CoverPolygon(Table):
    """A polygon of another material on the terrain, by its corners in local metres.

    polygon_m: corners of the polygon in their order, each in the coordinates of the scenario.
    material: on it; a name of the scenario's materials.
    """

    polygon_m: Annotated[tuple[Point2, ...], Field(min_length=3)]
    material: str


class CoverRaster(Table):
    """A raster of class values, each mapped to a material: GeoTIFF, PNG or a grid.

    path: the raster.
    classes: material by class value; ground of any other class keeps `terrain.material`. Over synthetic
    ground the raster's own coordinates are the local metres, and it has no CRS.
    """

    path: InputPath
    classes: dict[str, str]

    @model_validator(mode="after")
    def _whole_classes(self) -> CoverRaster:
        if not self.classes:
            raise refuse("classes", 'empty; map class values to materials, e.g. classes = {"1" = "forest"}')
        for key in self.classes:
            if not key.lstrip("-").isdecimal():
                raise refuse(f"classes.{key}", f"{key!r} is not a class value; give a whole number")
        return self

    @property
    def material_of_class(self) -> dict[int, str]:
        """Materials by class value."""
        return {int(key): name for key, name in self.classes.items()}


class CoverVector(Table):
    """Polygons with a class, each class mapped to a material: GeoJSON, GeoPackage or Shapefile.

    Where polygons overlap the later one in the file covers the earlier. They are transformed from the file's CRS; over
    ground that is on no map their coordinates are local metres.

    path: the vector file.
    attribute: that which holds the class.
    classes: material by class; ground of any other class, and beyond all polygons, keeps `terrain.material`.
    layer: of a GeoPackage with several.
    """

    path: InputPath
    attribute: Annotated[str, Field(min_length=1)]
    classes: dict[str, str]
    layer: str | None = None

    @model_validator(mode="after")
    def _some_class(self) -> CoverVector:
        if not self.classes:
            raise refuse("classes", 'empty; map classes to materials, e.g. classes = { forest = "forest" }')
        return self
