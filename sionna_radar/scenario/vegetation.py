"""Plants that stand on the ground as a volume: `[[vegetation]]`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from sionna_radar.scenario.table import Point2, Positive, Real, Table


class VegetationTable(Table):
    """A stand of plants: a layer on the ground that returns an echo from all of its depth and dims what lies under it.

    Both values are of the whole stand, gaps included. Measured millimetre-wave extinction is for instance in
    Recommendation ITU-R P.833, and by Jones, Espeland and Violette (NTIA, conifers in October 1987, 9.6 to 96.1 GHz).

    polygon_m: its outline on the map: corners in their order, each in the coordinates of the scenario; where stands
        overlap the last one counts.
    height_m: of its top over the ground.
    extinction_db_per_m: of power, one way.
    backscatter_db_per_m: radar cross-section of a cubic metre, in dB over a square metre.
    """

    polygon_m: Annotated[tuple[Point2, ...], Field(min_length=3)]
    height_m: Annotated[Positive, Field(le=100)]
    extinction_db_per_m: Annotated[Real, Field(ge=0, le=100)]
    backscatter_db_per_m: Annotated[Real, Field(ge=-100, le=30)]
