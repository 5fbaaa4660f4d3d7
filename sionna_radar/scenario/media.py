"""What a surface is made of, for a permittivity by a published formula: `medium = {kind = "soil", ...}`.

The formulas, their sources and the bands they reach are in `sionna_radar.surfaces.permittivity`.
"""

from typing import Annotated, Literal

from pydantic import Discriminator, Field

from sionna_radar.scenario.table import NonNegative, Positive, Real, Table

Percent = Annotated[Real, Field(ge=0, le=100)]
Fraction = Annotated[Real, Field(ge=0, le=1)]


class Soil(Table):
    """Unfrozen moist soil; water_fraction is by volume, specific_gravity that of the dry grains."""

    kind: Literal["soil"] = "soil"
    temperature_c: Real
    sand_percent: Percent
    clay_percent: Percent
    water_fraction: Fraction
    specific_gravity: Positive
    bulk_density_g_cm3: Positive | None = None


class Water(Table):
    """Pure liquid water."""

    kind: Literal["water"] = "water"
    temperature_c: Real


class Ice(Table):
    """Pure ice."""

    kind: Literal["ice"] = "ice"
    temperature_c: Real


class DrySnow(Table):
    """Dry snow: absorption only, no scattering by its grains."""

    kind: Literal["dry_snow"] = "dry_snow"
    temperature_c: Real
    density_g_cm3: Positive


class WetSnow(Table):
    """Wet snow; liquid_fraction is by volume."""

    kind: Literal["wet_snow"] = "wet_snow"
    temperature_c: Real
    dry_density_g_cm3: Positive
    liquid_fraction: Fraction


class Vegetation(Table):
    """Leaves and stalks themselves, not a canopy; water_fraction is by mass."""

    kind: Literal["vegetation"] = "vegetation"
    temperature_c: Real
    water_fraction: NonNegative


class Asphalt(Table):
    """A dry asphalt road; the number of the mix is its largest grain in millimetres."""

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
