"""Plants that stand on the ground as a volume: `[[vegetation]]`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from sionna_radar.scenario.table import InputPath, Point2, Positive, Real, Table, refuse


class VegetationTable(Table):
    """A stand of plants: a layer on the ground that returns an echo from all of its depth and dims what lies under it.

    Both values are of the whole stand, gaps included; the wind turns the phases of the plants (`weather.wind_mps`).
    Measured millimetre-wave extinction is for instance in Recommendation ITU-R P.833, and by Jones, Espeland and
    Violette (NTIA, conifers in October 1987, 9.6 to 96.1 GHz).

    polygon_m: its outline on the map: corners in their order, each in the coordinates of the scenario; where stands
        overlap the last one counts. With path it may be left out: all of the raster.
    height_m: of its top over the ground.
    path: instead of it, a raster of such heights in metres: a canopy-height model, as lidar gives it; or a point cloud,
        LAS or LAZ, whose highest points over the ground they are. One without a CRS is in local metres about its
        middle.
    classes: of a point cloud's plants.
    cloud_spacing_m: of the cells in which the highest of its points is taken.
    least_height_m: where that is lower, nothing stands.
    extinction_db_per_m: of power, one way.
    backscatter_db_per_m: radar cross-section of a cubic metre, in dB over a square metre.
    """

    polygon_m: Annotated[tuple[Point2, ...], Field(min_length=3)] | None = None
    height_m: Annotated[Positive, Field(le=100)] | None = None
    path: InputPath | None = None
    classes: Annotated[tuple[Annotated[int, Field(strict=True, ge=0, le=255)], ...], Field(min_length=1)] = (3, 4, 5)
    cloud_spacing_m: Annotated[Real, Field(ge=0.05, le=100)] = 1.0
    least_height_m: Positive = 0.5
    extinction_db_per_m: Annotated[Real, Field(ge=0, le=100)]
    backscatter_db_per_m: Annotated[Real, Field(ge=-100, le=30)]

    @model_validator(mode="after")
    def _one_height(self) -> VegetationTable:
        if (self.height_m is None) == (self.path is None):
            raise refuse("height_m", "give either height_m or path, not both and not neither")
        if self.polygon_m is None and self.path is None:
            raise refuse("polygon_m", "missing; give the corners of the stand's outline")
        if self.path is None and self.least_height_m != type(self).model_fields["least_height_m"].default:
            raise refuse("least_height_m", f"{self.least_height_m:g} has no effect without path; give it")
        for name in ("classes", "cloud_spacing_m"):
            if not self.of_cloud and getattr(self, name) != type(self).model_fields[name].default:
                raise refuse(name, "has no effect without a point cloud; remove it, or give one as path")
        return self

    @property
    def of_cloud(self) -> bool:
        """Whether the heights come from a point cloud."""
        return self.path is not None and self.path.suffix.lower() in (".las", ".laz")
