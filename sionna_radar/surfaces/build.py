"""Builder of the materials of a scenario: registration, models by name, permittivity, and checks of validity."""

import logging
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from sionna_radar.foundation.decibels import from_db, to_db
from sionna_radar.foundation.errors import PluginError, Problem, RadarError, ScenarioError
from sionna_radar.scenario.bases import MaterialParameters
from sionna_radar.scenario.materials import (
    Asphalt,
    BuildingMedium,
    ConstantGamma,
    DrySnow,
    EmpiricalTable,
    Ice,
    IntegralEquation,
    Kirchhoff,
    Lambertian,
    MeasuredTable,
    Medium,
    PhysicalOptics,
    RoughTable,
    SionnaItu,
    SmallPerturbation,
    Soil,
    SurfaceTable,
    UlabyDobson,
    Vegetation,
    Water,
)
from sionna_radar.scenario.parts import MATERIALS
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scenario.registry import Builder, registers, require
from sionna_radar.surfaces import rough_surface
from sionna_radar.surfaces.backscatter import (
    Backscatter,
    ConstantGammaBackscatter,
    LambertianBackscatter,
    TableBackscatter,
    UlabyDobsonBackscatter,
)
from sionna_radar.surfaces.motion import SurfaceMotion
from sionna_radar.surfaces.permittivity import (
    SOURCES,
    asphalt_permittivity,
    building_permittivity,
    dry_snow_permittivity,
    ice_permittivity,
    soil_permittivity,
    vegetation_permittivity,
    water_permittivity,
    wet_snow_permittivity,
)
from sionna_radar.surfaces.radar_material import Channel, Mirror, RadarMaterial, as_radar_material, typical_cross_polar
from sionna_radar.surfaces.sionna_slab import SionnaSlab, slab_material


def permittivity_of(medium: Medium, carrier_hz: float) -> complex:
    """Return the complex permittivity of a medium; ValueError names the parameter out of range."""
    parameters = medium.model_dump(exclude={"kind"})
    match medium:
        case BuildingMedium():
            return building_permittivity(medium.kind, carrier_hz)
        case Soil():
            return soil_permittivity(carrier_hz, **parameters)
        case Water():
            return water_permittivity(carrier_hz, **parameters)
        case Ice():
            return ice_permittivity(carrier_hz, **parameters)
        case DrySnow():
            return dry_snow_permittivity(carrier_hz, **parameters)
        case Asphalt():
            return asphalt_permittivity(carrier_hz, **parameters)
        case Vegetation():
            return vegetation_permittivity(carrier_hz, **parameters)
    return wet_snow_permittivity(carrier_hz, **parameters)


def extrapolation_of(medium: Medium, carrier_hz: float) -> str | None:
    """Return a note on a formula used beyond its measured band; None within it."""
    source = SOURCES.get(medium.kind)
    if source is None or source.measured_hz is None:
        return None
    lowest, highest = source.measured_hz
    if lowest <= carrier_hz <= highest:
        return None
    return (
        f"{medium.kind} at {carrier_hz / 1e9:g} GHz extrapolates measurements made from {lowest / 1e9:g} to "
        f"{highest / 1e9:g} GHz ({source.document})"
    )


logger = logging.getLogger("sionna_radar")

# Largest checked incidence: beyond, models are least reliable and echoes few.
STEEPEST_CHECKED_DEG = 85


@registers(MATERIALS, "[materials.NAME]")
def register_material(name: str, parameters: type[MaterialParameters]) -> Callable[[Builder], Builder]:
    """Register a backscatter model, for `materials.NAME.model` in a scenario.

    It decorates a class or function that builds a `Backscatter` (or a `RadarMaterial`, which distinguishes
    polarizations); it is called with the parameters, the carrier (Hz) and the channel, such as "VV".

    Examples
    --------
    >>> import numpy as np
    >>> from sionna_radar.scenario import MaterialParameters
    >>> class Moss(MaterialParameters):
    ...     level_db: float = -12.0
    >>> @register_material("moss", Moss)
    ... class MossBackscatter:
    ...     def __init__(self, parameters, carrier_hz, channel):
    ...         self.level = 10 ** (parameters.level_db / 10)
    ...     def sigma0(self, incidence_rad):
    ...         return self.level * np.cos(incidence_rad)
    >>> scenario = load_scenario("hills", {"materials.ground": {"model": "moss", "level_db": -20.0}})
    >>> scenario.materials["ground"].level_db
    -20.0
    """
    return MATERIALS.register(name, parameters)


def channel_of(radar: RadarTable) -> Channel:
    """Return the polarization channel of a radar: received first, then transmitted."""
    transmitted = radar.antenna.polarization
    if transmitted in ("RHCP", "LHCP"):
        return "same" if radar.antenna.receive_polarization == "co" else "opposite"
    if radar.antenna.receive_polarization == "co":
        return "VV" if transmitted == "V" else "HH"
    return "HV" if transmitted == "V" else "VH"


def build_materials(tables: dict[str, MaterialParameters], radar: RadarTable) -> dict[str, RadarMaterial]:
    """Return the materials of a scenario, and warn of those used outside their range of validity.

    Raises
    ------
    ScenarioError
        Parameters outside the range of a formula, each with its dotted key.
    InputFileError
        A table cannot be read.
    """
    channel, built, problems = channel_of(radar), {}, []
    for name, table in tables.items():
        try:
            model = MATERIALS.entry(table.model)(table, radar.carrier_hz, channel)
            check_backscatter(model, f"materials.{name}: {MATERIALS.entry(table.model)}")
            built[name] = as_radar_material(model, channel)
        except RadarError:
            raise
        except ValueError as error:
            problems.append(Problem(_key(f"materials.{name}", table, str(error)), str(error)))
    if problems:
        raise ScenarioError(problems)
    for name, table in tables.items():
        for doubt in doubts(table, built[name], radar.carrier_hz):
            logger.warning("materials.%s: %s", name, doubt)
    return built


def motions_of(tables: Mapping[str, MaterialParameters]) -> dict[str, SurfaceMotion]:
    """Return the motions of surfaces in the wind, by the material's name, without static ones."""
    return {
        name: SurfaceMotion(kind=table.motion, fetch_m=table.fetch_m)
        for name, table in tables.items()
        if isinstance(table, SurfaceTable) and table.motion != "still"
    }


def check_backscatter(model: object, what: str) -> None:
    """Check that an object is a backscatter model and returns valid powers.

    Raises PluginError, whose message begins with `what`.
    """
    require(model, Backscatter, what)
    assert isinstance(model, Backscatter)
    incidence_rad = np.deg2rad([0.0, 30.0, 60.0])
    sigma0 = np.asarray(model.sigma0(incidence_rad))
    if sigma0.shape != incidence_rad.shape or not np.all(np.isfinite(sigma0) & (sigma0 >= 0)):
        message = f"{what}: sigma0 at 0, 30 and 60 deg is {sigma0}; return a finite ratio, not negative, for each angle"
        raise PluginError(message)


def doubts(table: MaterialParameters, material: RadarMaterial, carrier_hz: float) -> list[str]:
    """Return warnings about a material at the carrier: violated conditions, and more power scattered than incident."""
    messages = []
    if isinstance(table, SurfaceTable) and table.cross_polar_db is None and material.cross_polar > 0:
        messages.append(
            "no cross_polar_db is given, which determines the echo of a circular wave; assumed to be "
            f"{to_db(material.cross_polar):g}"
        )
    if isinstance(table, SurfaceTable) and table.medium is not None:
        note = extrapolation_of(table.medium, carrier_hz)
        messages += [note] if note else []
    validity: Callable[[], list[str]] = getattr(material.vertical, "validity", list)
    messages += [f"outside the range of {table.model}: {text}" for text in validity()]
    angle_deg = np.arange(STEEPEST_CHECKED_DEG + 1)
    scattered = material.scattered_fraction(np.deg2rad(angle_deg))
    if scattered.max() > 1:
        exceeding_deg = angle_deg[scattered > 1]
        messages.append(
            f"it would scatter up to {100 * (scattered.max() - 1):.4g} % more power than it receives, between "
            f"{exceeding_deg[0]} and {exceeding_deg[-1]} deg of incidence"
        )
    return messages


def _key(name: str, table: MaterialParameters, message: str) -> str:
    """Return the dotted key for a formula's error message, which starts with the parameter's name."""
    match = re.match(r"\w*", message)
    field = match.group() if match else ""
    if isinstance(table, SionnaItu):
        return f"{name}.itu_type"
    if field in type(table).model_fields:
        return f"{name}.{field}"
    medium = getattr(table, "medium", None)
    if medium is not None and field in type(medium).model_fields:
        return f"{name}.medium.{field}"
    return f"{name}.medium" if medium is not None else name


def polarized_material(
    table: EmpiricalTable | RoughTable,
    vertical: Backscatter,
    horizontal: Backscatter,
    carrier_hz: float,
    channel: Channel,
) -> RadarMaterial:
    """Return a surface of co-polar models for V and H, with the other settings of its table."""
    return RadarMaterial(
        vertical=vertical,
        horizontal=horizontal,
        cross_polar=typical_cross_polar(channel) if table.cross_polar_db is None else from_db(table.cross_polar_db),
        copolar_correlation=table.copolar_correlation,
        channel=channel,
        mirror=_mirror(table, table_permittivity(table, carrier_hz), carrier_hz),
    )


def table_permittivity(table: EmpiricalTable | RoughTable, carrier_hz: float) -> complex | None:
    """Return the permittivity of a surface; None if its table does not give one."""
    if table.medium is not None:
        return permittivity_of(table.medium, carrier_hz)
    return None if table.permittivity is None else complex(table.permittivity[0], -table.permittivity[1])


def _mirror(table: EmpiricalTable | RoughTable, permittivity: complex | None, carrier_hz: float) -> Mirror | None:
    if not table.specular or permittivity is None or table.rms_height_m is None:
        return None
    return Mirror(permittivity=permittivity, rms_height_m=table.rms_height_m, frequency_hz=carrier_hz)


def constant_gamma(table: ConstantGamma, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material of constant gamma."""
    model = ConstantGammaBackscatter(table.gamma)
    return polarized_material(table, model, model, carrier_hz, channel)


def lambertian(table: Lambertian, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material that follows Lambert's law."""
    model = LambertianBackscatter(from_db(table.nadir_sigma0_db))
    return polarized_material(table, model, model, carrier_hz, channel)


def ulaby_dobson(table: UlabyDobson, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material with a fitted curve of Ulaby and Dobson's form."""
    model = UlabyDobsonBackscatter(
        **{f"p{i}": getattr(table, f"p{i}") for i in range(1, 7)},
        min_incidence_rad=np.deg2rad(table.min_incidence_deg),
        max_incidence_rad=np.deg2rad(table.max_incidence_deg),
        source=table.source,
    )
    return polarized_material(table, model, model, carrier_hz, channel)


def measured(table: MeasuredTable, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material with a measured curve."""
    model = TableBackscatter.from_csv(table.path)
    return polarized_material(table, model, model, carrier_hz, channel)


def kirchhoff(table: Kirchhoff, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material that follows geometrical optics."""
    return _rough(rough_surface.GeometricalOptics, table, carrier_hz, channel)


def physical_optics(table: PhysicalOptics, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material that follows Kirchhoff's scalar series."""
    return _rough(rough_surface.PhysicalOpticsModel, table, carrier_hz, channel)


def small_perturbation(table: SmallPerturbation, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material that scatters by Bragg's resonance."""
    return _rough(rough_surface.SmallPerturbationModel, table, carrier_hz, channel)


def integral_equation(table: IntegralEquation, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material that follows the integral-equation model."""
    return _rough(rough_surface.IntegralEquationModel, table, carrier_hz, channel, fresnel_angle=table.fresnel_angle)


def _rough(
    model: Callable[..., Backscatter], table: RoughTable, carrier_hz: float, channel: Channel, **options: Any
) -> RadarMaterial:
    permittivity = table_permittivity(table, carrier_hz)
    assert permittivity is not None  # checked with the scenario
    surface = table.to(rough_surface.RoughSurface, permittivity=permittivity, frequency_hz=carrier_hz)
    vertical, horizontal = (model(surface=surface, polarization=p, **options) for p in "VH")
    return polarized_material(table, vertical, horizontal, carrier_hz, channel)


def sionna_itu(table: SionnaItu, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return the material of a slab given in a scenario."""
    return slab_material(table.to(SionnaSlab), carrier_hz, channel)
