"""What a surface is made of, for a permittivity by a published formula: `medium = {kind = "soil", ...}`.

The formulas, their sources and the bands they reach are in `sionna_radar.surfaces.permittivity`.
"""

from typing import Annotated, Literal

from pydantic import Discriminator, Field

from sionna_radar.scenario.table import NonNegative, Positive, Real, Table

Percent = Annotated[Real, Field(ge=0, le=100)]
Fraction = Annotated[Real, Field(ge=0, le=1)]


class Soil(Table):
    """Unfrozen moist soil.

    temperature_c: of the soil.
    sand_percent: by weight, of the dry soil.
    clay_percent: by weight, of the dry soil.
    water_fraction: by volume.
    specific_gravity: of the dry grains.
    bulk_density_g_cm3: of the dry soil; without it that which its composition has.
    """

    kind: Literal["soil"] = "soil"
    temperature_c: Real
    sand_percent: Percent
    clay_percent: Percent
    water_fraction: Fraction
    specific_gravity: Positive
    bulk_density_g_cm3: Positive | None = None


class Water(Table):
    """Pure liquid water.

    temperature_c: of the water.
    """

    kind: Literal["water"] = "water"
    temperature_c: Real


class Ice(Table):
    """Pure ice.

    temperature_c: of the ice.
    """

    kind: Literal["ice"] = "ice"
    temperature_c: Real


class DrySnow(Table):
    """Dry snow: absorption only, no scattering by its grains.

    temperature_c: of the snow.
    density_g_cm3: of the snow.
    """

    kind: Literal["dry_snow"] = "dry_snow"
    temperature_c: Real
    density_g_cm3: Positive


class WetSnow(Table):
    """Wet snow.

    temperature_c: of the snow.
    dry_density_g_cm3: without its liquid water.
    liquid_fraction: by volume.
    """

    kind: Literal["wet_snow"] = "wet_snow"
    temperature_c: Real
    dry_density_g_cm3: Positive
    liquid_fraction: Fraction


class Vegetation(Table):
    """Leaves and stalks themselves, not a canopy.

    temperature_c: of the leaves.
    water_fraction: by mass.
    """

    kind: Literal["vegetation"] = "vegetation"
    temperature_c: Real
    water_fraction: NonNegative


class Asphalt(Table):
    """A dry asphalt road.

    mix: asphalt concrete or stone mastic, with the largest grain in millimetres.
    """

    kind: Literal["asphalt"] = "asphalt"
    mix: Literal["AC11DS", "SMA8S", "SMA11S"]


class BuildingMedium(Table):
    """A material of ITU-R P.2040-3, Table 3."""

    kind: Literal[
        "concrete",
        "brick",
        "plasterboard",
        "wood",
        "glass",
        "ceiling_board",
        "chipboard",
        "plywood",
        "marble",
        "floorboard",
        "asphalt_concrete",
        "metal",
    ]


Medium = Annotated[
    Soil | Water | Ice | DrySnow | WetSnow | Vegetation | Asphalt | BuildingMedium,
    Discriminator("kind"),
]
