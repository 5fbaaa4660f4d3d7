"""Objects in a scene besides the ground: `[[buildings]]` and `[[targets]]`."""

from typing import Annotated

from pydantic import Field

from sionna_radar.scenario.table import NonNegative, Point2, Positive, Real, Table


class Building(Table):
    """A box that stands on the lowest ground under it; heading 0 puts its length along north."""

    position_m: Point2
    size_m: tuple[Positive, Positive, Positive]
    heading_deg: Real = 0.0
    material: str = "building"


class PointTarget(Table):
    """A point of given mean radar cross-section, constant or by Swerling's cases, at a height above the ground."""

    position_m: Point2
    height_m: NonNegative = 0.0
    rcs_dbsm: Annotated[Real, Field(ge=-100, le=100)]
    swerling: Annotated[int, Field(strict=True, ge=0, le=4)] = 0
