"""Tables `[materials.NAME]` of backscatter models, selected by `model`, and of media for their permittivity.

Every material may have a cross-polar ratio and a mirror reflection. A mirror needs to know what the surface is
made of and how rough it is; the rough-surface models have both, the others take them from the same keys.

A medium, `medium = {kind = "soil", ...}`, gives what a surface is made of, for a permittivity by a published formula.
The formulas, their sources and the bands they reach are in `sionna_radar.surfaces.permittivity`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, field_validator

from sionna_radar.scenario.bases import MaterialParameters
from sionna_radar.scenario.choice import ChosenBy
from sionna_radar.scenario.parts import MATERIALS
from sionna_radar.scenario.table import Conflicts, InputPath, NonNegative, Positive, Real, Table, refuse

Percent = Annotated[Real, Field(ge=0, le=100)]
Fraction = Annotated[Real, Field(ge=0, le=1)]


class Soil(Table):
    """Unfrozen moist soil."""

    kind: Literal["soil"] = "soil"
    temperature_c: Real
    """Temperature of the soil."""
    sand_percent: Percent
    """Sand content of the dry soil, by weight."""
    clay_percent: Percent
    """Clay content of the dry soil, by weight."""
    water_fraction: Fraction
    """Volumetric water content of the soil, 0 to 1."""
    specific_gravity: Positive
    """Specific gravity of the dry grains, relative to water."""
    bulk_density_g_cm3: Positive | None = None
    """Bulk density of the dry soil. Default: computed from its composition."""


class Water(Table):
    """Pure liquid water."""

    kind: Literal["water"] = "water"
    temperature_c: Real
    """Temperature of the water."""


class Ice(Table):
    """Pure ice."""

    kind: Literal["ice"] = "ice"
    temperature_c: Real
    """Temperature of the ice."""


class DrySnow(Table):
    """Dry snow: absorption only, no scattering by its grains."""

    kind: Literal["dry_snow"] = "dry_snow"
    temperature_c: Real
    """Temperature of the snow."""
    density_g_cm3: Positive
    """Density of the snow."""


class WetSnow(Table):
    """Wet snow."""

    kind: Literal["wet_snow"] = "wet_snow"
    temperature_c: Real
    """Temperature of the snow."""
    dry_density_g_cm3: Positive
    """Density of the snow without its liquid water."""
    liquid_fraction: Fraction
    """Liquid water content of the snow by volume, 0 to 1."""


class Vegetation(Table):
    """Leaves and stalks themselves, not a canopy."""

    kind: Literal["vegetation"] = "vegetation"
    temperature_c: Real
    """Temperature of the leaves."""
    water_fraction: NonNegative
    """Gravimetric water content of the leaves."""


class Asphalt(Table):
    """A dry asphalt road."""

    kind: Literal["asphalt"] = "asphalt"
    mix: Literal["AC11DS", "SMA8S", "SMA11S"]
    """Asphalt mix: asphalt concrete (AC) or stone mastic (SMA), with the largest grain in millimetres."""


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


Level = Annotated[Real, Field(ge=-100, le=20)]
Incidence = Annotated[Real, Field(ge=0, le=90)]

# Rouveure et al. 2017, Table 1 (gamma, linear).
TERRAIN_CLASSES = {
    "city": 83.17e-3,
    "mountain": 6.92e-3,
    "forest": 3.16e-3,
    "rolling_hills": 1.32e-3,
    "desert": 0.06e-3,
}


class SurfaceTable(MaterialParameters):
    """Keys common to all backscatter models."""

    cross_polar_db: Annotated[Real, Field(ge=-100, le=0)] | None = None
    """Cross-polar sigma0 over the co-polar one, the weaker of V and H. Default: none for a linear antenna, and a
    typical ratio for a circular one."""
    copolar_correlation: Annotated[Real, Field(ge=0, le=1)] | None = None
    """Correlation of VV and HH from 20 deg off nadir on, for circular waves. Default: that of a surface with azimuthal
    symmetry about the line of sight, 1 - 2 cross-polar ratio: 0.8 at -10 dB."""
    specular: bool = Field(default=False, strict=True)
    """Whether plane facets that are large against the Fresnel zone also reflect as a mirror, at normal incidence."""
    permittivity: tuple[Annotated[Real, Field(ge=1)], NonNegative] | None = None
    """Relative permittivity [eps', eps''] of eps' - j eps''; or give a `medium` to compute it from."""
    medium: Medium | None = None
    """Medium of the surface, for a permittivity by a published formula; alternative to `permittivity`."""
    motion: Literal["still", "plants", "water"] = "still"
    """Motion by `weather.wind_mps`: "plants" give each scatterer a Doppler shift of its own, which shows where speckle
    persists; "water" moves by its waves."""
    fetch_m: Annotated[Real, Field(ge=1, le=1e6)] = 1000.0
    """Fetch: length of water over which the wind has blown."""

    def _conflicts(self) -> Conflicts:
        if self.motion != "water" and self.fetch_m != SurfaceTable.model_fields["fetch_m"].default:
            yield "fetch_m", "has no effect here; remove it, or set motion = 'water'"

    def _conflicts_of_media(self) -> Conflicts:
        if self.permittivity is not None and self.medium is not None:
            yield "medium", "contradicts permittivity; give the one or the other"
        if self.permittivity is None and self.medium is None:
            yield "permittivity", 'missing; give permittivity = [real, loss], or medium = {kind = "soil", ...}'


class EmpiricalTable(SurfaceTable):
    """A model of the diffuse return alone; the roughness and medium of a mirror reflection are separate keys."""

    rms_height_m: NonNegative | None = None
    """RMS height of the mirror's roughness; 0 for a smooth one."""

    def _conflicts(self) -> Conflicts:
        yield from super()._conflicts()
        mirror_keys = [k for k in ("permittivity", "medium", "rms_height_m") if getattr(self, k) is not None]
        if not self.specular and mirror_keys:
            yield mirror_keys[0], "has no effect here; remove it, or set specular = true"
        if self.specular:
            yield from self._conflicts_of_media()
            if self.rms_height_m is None:
                yield "rms_height_m", "missing; a mirror reflection needs the rms height, 0 if smooth"


class ConstantGamma(EmpiricalTable):
    """sigma0 = gamma cos(incidence): the paper's model, by its terrain class or by value."""

    model: Literal["constant_gamma"] = "constant_gamma"
    terrain_class: Literal["city", "mountain", "forest", "rolling_hills", "desert"] | None = None
    """Terrain class of the paper's Table 1, which sets gamma."""
    gamma_db: Level | None = None
    """Gamma, as an alternative to `terrain_class`."""

    def _conflicts(self) -> Conflicts:
        yield from super()._conflicts()
        if (self.terrain_class is None) == (self.gamma_db is None):
            yield "gamma_db", "give either gamma_db or terrain_class, not both and not neither"

    @property
    def gamma(self) -> float:
        """Gamma as a linear ratio."""
        if self.gamma_db is not None:
            return float(10 ** (self.gamma_db / 10))
        assert self.terrain_class is not None
        return TERRAIN_CLASSES[self.terrain_class]


class Lambertian(EmpiricalTable):
    """sigma0 = sigma0(nadir) cos^2(incidence): Lambert's law of diffuse reflection."""

    model: Literal["lambertian"] = "lambertian"
    nadir_sigma0_db: Level
    """Sigma0 at normal incidence."""


class UlabyDobson(EmpiricalTable):
    """sigma0 (dB) = p1 + p2 exp(-p3 t) + p4 cos(p5 t + p6), t in radians, with the user's own parameters.

    None is shipped: those published could not be read for this band (see `surfaces.backscatter`).
    """

    model: Literal["ulaby_dobson"] = "ulaby_dobson"
    p1: Real
    """Parameter p1, the level in dB."""
    p2: Real
    """Parameter p2, in dB."""
    p3: Real
    """Parameter p3, per radian."""
    p4: Real
    """Parameter p4, in dB."""
    p5: Real
    """Parameter p5, without unit."""
    p6: Real
    """Parameter p6, in radians."""
    min_incidence_deg: Incidence
    """Least incidence at which the parameters are valid."""
    max_incidence_deg: Incidence
    """Greatest incidence at which the parameters are valid."""
    source: Annotated[str, Field(min_length=1)]
    """Source of the parameters: document, band, polarization."""

    def _conflicts(self) -> Conflicts:
        yield from super()._conflicts()
        if self.min_incidence_deg >= self.max_incidence_deg:
            message = f"{self.max_incidence_deg:g} must exceed min_incidence_deg = {self.min_incidence_deg:g}"
            yield "max_incidence_deg", message
        if not self.source.strip():
            yield "source", "empty; say where the parameters come from: document, band, polarization"


class MeasuredTable(EmpiricalTable):
    """sigma0 measured: a CSV file with the columns incidence_deg and sigma0_db."""

    model: Literal["table"] = "table"
    path: InputPath
    """CSV file of the measured sigma0."""


class RoughTable(SurfaceTable):
    """A randomly rough surface of a homogeneous medium."""

    rms_height_m: Positive
    """RMS height of the surface."""
    correlation_length_m: Positive
    """Correlation length of the surface's height."""
    correlation: Literal["gaussian", "exponential"] = "gaussian"
    """Shape of the correlation function."""

    def _conflicts(self) -> Conflicts:
        yield from super()._conflicts()
        yield from self._conflicts_of_media()


class Kirchhoff(RoughTable):
    """Geometrical optics: very rough, gently sloping."""

    model: Literal["kirchhoff"] = "kirchhoff"

    def _conflicts(self) -> Conflicts:
        yield from super()._conflicts()
        if self.correlation == "exponential":
            yield "correlation", "'exponential' has no rms slope; use 'gaussian', or model = \"integral_equation\""


class PhysicalOptics(RoughTable):
    """Kirchhoff's scalar series: gently sloping, any height."""

    model: Literal["physical_optics"] = "physical_optics"


class SmallPerturbation(RoughTable):
    """First-order Bragg scattering of a slightly rough surface."""

    model: Literal["small_perturbation"] = "small_perturbation"


class IntegralEquation(RoughTable):
    """The integral-equation model, single scattering; `fresnel_angle` is where its reflection is taken.

    "transition" goes from "incidence" to "nadir" as the surface gets rougher. At "nadir" sigma0 grows without bound
    toward grazing.
    """

    model: Literal["integral_equation"] = "integral_equation"
    fresnel_angle: Literal["transition", "incidence", "nadir"] = "transition"
    """Angle at which the Fresnel reflection coefficient is taken: "nadir", the local "incidence", or a "transition"
    between both by roughness."""


class SionnaItu(MaterialParameters):
    """A slab with the coefficients of Sionna RT's ITURadioMaterial: `scattering_coefficient` of the field scatters.

    The scattering matrix is that of the materials above, which keeps the polarization at every scan angle; Sionna's
    own loses 4.5 to 24 dB of the co-polar echo off nadir.
    """

    model: Literal["sionna_itu"] = "sionna_itu"
    itu_type: str
    """Material of ITU-R P.2040, as Sionna RT names it."""
    scattering_coefficient: Annotated[Real, Field(gt=0, le=1)]
    """Fraction of the reflected field that is scattered."""
    xpd_coefficient: Annotated[Real, Field(ge=0, lt=1)] = 0.0
    """Fraction of the scattered power that is cross-polarized."""
    thickness_m: Positive = 0.1
    """Thickness of the slab."""

    @field_validator("itu_type")
    @classmethod
    def _is_something(cls, value: str) -> str:
        if value == "vacuum":
            raise refuse("", "'vacuum' reflects nothing, so there is no echo; give another ITU material")
        return value


Material = Annotated[MaterialParameters, ChosenBy("model", MATERIALS)]

DEFAULT_MATERIALS: dict[str, MaterialParameters] = {
    "ground": ConstantGamma(terrain_class="rolling_hills"),
    "building": ConstantGamma(terrain_class="city"),
}
