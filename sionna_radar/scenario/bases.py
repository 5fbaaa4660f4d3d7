"""What the tables of all scans, antennas, navigation systems, terrains and materials share, ours and custom ones."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from sionna_radar.scenario.cover import CoverPolygon, CoverRaster, CoverVector
from sionna_radar.scenario.table import Point2, Real, Table

# Products count places in whole millimetres, 32 bits of them; no navigation system errs by so much.
Offset = Annotated[Real, Field(ge=-1e4, le=1e4)]


class ScanParameters(Table):
    """A scan, by its mode.

    stabilised: roll and pitch of the platform are taken out of the pointing.
    """

    mode: str
    stabilised: bool = Field(default=True, strict=True)


class AntennaParameters(Table):
    """An antenna, by its kind.

    polarization: as sent: V or H, or circular to the right or the left (IEEE: as seen along the way of the wave).
    receive_polarization: "co" receives the same, "cross" the orthogonal one. Of a circular antenna "co" is the same
    sense, in which spheres and mirrors return nothing, and "cross" the opposite sense.
    """

    kind: str
    polarization: Literal["V", "H", "RHCP", "LHCP"] = "V"
    receive_polarization: Literal["co", "cross"] = "co"


class NavigationParameters(Table):
    """A navigation system, by its kind.

    lever_arm_m: from it to the antenna: nose, right, down.
    """

    kind: str
    lever_arm_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)


class TerrainParameters(Table):
    """A terrain, by its kind.

    centre_lonlat_deg: longitude and latitude (WGS 84) of the local origin. Without it a file's own middle, or, for
    ground that is on no map, none: everything about it is then in local metres.
    """

    kind: str
    centre_lonlat_deg: Point2 | None = None


class CoveredTerrain(TerrainParameters):
    """Ground of one material, with others over it: classes of a raster, then of a vector file, then polygons.

    Each covers those before it; polygons do in the order given.

    material: of the ground; a name of the scenario's materials.
    cover_raster: a raster of land-cover classes.
    cover_vector: a vector file of land-cover classes.
    cover: polygons of other materials.
    """

    material: str = "ground"
    cover_raster: CoverRaster | None = None
    cover_vector: CoverVector | None = None
    cover: tuple[CoverPolygon, ...] = ()


class MaterialParameters(Table):
    """A material, by the model of its backscatter."""

    model: str


class StageParameters(Table):
    """A stage of the receiver, by its name.

    stage: what it is called.
    """

    stage: str
