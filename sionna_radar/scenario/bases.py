"""Base tables of all scans, antennas, navigation systems, terrains and materials, built-in and custom."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from sionna_radar.scenario.cover import CoverPolygon, CoverRaster, CoverVector
from sionna_radar.scenario.table import NonNegative, Point2, Real, Table

# Lever arms and offsets stay within the range of positions stored as 32-bit millimetres.
Offset = Annotated[Real, Field(ge=-1e4, le=1e4)]
# Standard deviations of one number for all three axes, or one for each.
Spread = Annotated[NonNegative, Field(le=1e4)]
SpreadAxes = Spread | tuple[Spread, Spread, Spread]
# Errors of attitude are small angles: the stated uncertainty is linear in them, which overstates by a sixth of the
# square, 5 % at 30 deg; and three standard deviations of Gaussian angles stay within a quarter of a turn.
LARGEST_ATTITUDE_ERROR_DEG = 30
AttitudeSpread = Annotated[NonNegative, Field(le=LARGEST_ATTITUDE_ERROR_DEG)]
AttitudeSpreadAxes = AttitudeSpread | tuple[AttitudeSpread, AttitudeSpread, AttitudeSpread]
AttitudeError = Annotated[Real, Field(ge=-LARGEST_ATTITUDE_ERROR_DEG, le=LARGEST_ATTITUDE_ERROR_DEG)]
AttitudeErrorAxes = AttitudeError | tuple[AttitudeError, AttitudeError, AttitudeError]


class ScanParameters(Table):
    """A scan, by its mode."""

    mode: str
    stabilised: bool = Field(default=True, strict=True)
    """Whether the pointing is stabilised against roll and pitch of the platform."""


class AntennaParameters(Table):
    """An antenna, by its kind."""

    kind: str
    polarization: Literal["V", "H", "RHCP", "LHCP"] = "V"
    """Transmitted polarization: V or H, or right- or left-hand circular (IEEE: as seen along the direction of
    propagation)."""
    receive_polarization: Literal["co", "cross"] = "co"
    """Received polarization: "co" is the transmitted one, "cross" the orthogonal one. For a circular antenna "co" is
    the same sense, in which single reflections from spheres and mirrors return nothing, and "cross" the opposite
    sense."""
    squint_deg_per_ghz: Annotated[Real, Field(ge=-90, le=90)] = 0.0
    """Frequency squint: turn of the beam to the left about the antenna's up axis as the frequency rises over the sweep,
    as of a slotted waveguide. The given pattern is that in the middle of the used sweep."""


class NavigationParameters(Table):
    """A navigation system, by its kind."""

    kind: str
    lever_arm_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    """Lever arm from the navigation system's reference point to the antenna, in body axes: nose, right, down."""


class TerrainParameters(Table):
    """A terrain, by its kind."""

    kind: str
    centre_lonlat_deg: Point2 | None = None
    """Longitude and latitude (WGS 84) of the local origin. Default: the middle of the elevation file; terrain that is
    on no map has none, and everything about it is then in local metres."""


class CoveredTerrain(TerrainParameters):
    """Ground of one material, with others over it: classes of a raster, then of a vector file, then polygons.

    Each covers those before it; polygons do in the order given.
    """

    material: str = "ground"
    """Material of the ground; a name of the scenario's materials."""
    cover_raster: CoverRaster | None = None
    """Raster of land-cover classes."""
    cover_vector: CoverVector | None = None
    """Vector file of land-cover classes."""
    cover: tuple[CoverPolygon, ...] = ()
    """Polygons of other materials."""


class MaterialParameters(Table):
    """A material, by the model of its backscatter."""

    model: str


class StageParameters(Table):
    """A stage of the receiver, by its name."""

    stage: str
    """Name of the receiver stage."""
