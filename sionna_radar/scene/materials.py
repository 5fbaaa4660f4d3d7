"""Building the materials of a scenario at its carrier and polarisation, and saying where they do not hold."""

import logging
import re
from collections.abc import Callable

import numpy as np

from sionna_radar.foundation.decibel import from_db
from sionna_radar.foundation.errors import Problem, RadarError, ScenarioError
from sionna_radar.scenario.materials import (
    ConstantGamma,
    EmpiricalTable,
    IntegralEquation,
    Kirchhoff,
    Lambertian,
    Material,
    MeasuredTable,
    PhysicalOptics,
    RoughTable,
    SionnaItu,
    SmallPerturbation,
    SurfaceTable,
    UlabyDobson,
)
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scene.sionna_slab import SionnaSlab, slab_material
from sionna_radar.surfaces import rough_surface
from sionna_radar.surfaces.backscatter import Backscatter, ConstantGammaBackscatter, LambertianBackscatter
from sionna_radar.surfaces.measured_backscatter import TableBackscatter, UlabyDobsonBackscatter
from sionna_radar.surfaces.medium import extrapolation_of, permittivity_of
from sionna_radar.surfaces.radar_material import Channel, Mirror, RadarMaterial

logger = logging.getLogger("sionna_radar")

# Bare ground, rough against the wavelength: s_hv / s_vv = 0.23 sqrt(G) by Oh, Sarabandi and Ulaby 1992 (IEEE TGRS 30,
# 370-381), which Ulaby and others 1998 ("95-GHz scattering by terrain at near-grazing incidence", IEEE TAP 46, 3-13)
# compare with measurements at 95 GHz; G, the reflection straight down, is 0.1 to 0.3 of soils, so -11 to -9 dB. Grass
# and other vegetation have more.
TYPICAL_CROSS_POLAR_DB = -10.0
# Beyond this every model is at its weakest, and a survey has few echoes.
STEEPEST_CHECKED_DEG = 85


def channel_of(radar: RadarTable) -> Channel:
    """Return what a radar sends and receives: received first, then sent."""
    sent = radar.antenna.polarization
    if sent in ("RHCP", "LHCP"):
        return "same" if radar.antenna.receive_polarization == "co" else "opposite"
    if radar.antenna.receive_polarization == "co":
        return "VV" if sent == "V" else "HH"
    return "HV" if sent == "V" else "VH"


def build_materials(tables: dict[str, Material], radar: RadarTable) -> dict[str, RadarMaterial]:
    """Return the materials of a scenario, and log which are used beyond their range.

    Raises
    ------
    ScenarioError
        Parameters out of the range of a formula, each with its dotted key.
    InputFileError
        A table cannot be read.

    """
    built, problems = {}, []
    for name, table in tables.items():
        try:
            built[name] = _build(table, radar.carrier_hz, channel_of(radar))
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


def doubts(table: Material, material: RadarMaterial, carrier_hz: float) -> list[str]:
    """Return what to know of a material at the carrier: conditions it violates, and power out of nothing."""
    found = []
    if isinstance(table, SurfaceTable) and table.cross_polar_db is None and material.cross_polar > 0:
        found.append(
            f"no cross_polar_db is given, which rules the echo of a circular wave; taken as {TYPICAL_CROSS_POLAR_DB:g}"
        )
    if isinstance(table, SurfaceTable) and table.medium is not None:
        note = extrapolation_of(table.medium, carrier_hz)
        found += [note] if note else []
    validity: Callable[[], list[str]] = getattr(material.vertical, "validity", list)
    found += [f"outside the range of {table.model}: {text}" for text in validity()]
    angle_deg = np.arange(STEEPEST_CHECKED_DEG + 1)
    share = material.scattered_share(np.deg2rad(angle_deg))
    if share.max() > 1:
        over = angle_deg[share > 1]
        found.append(
            f"it would scatter more power than it receives, {share.max():.3g} times at worst, between {over[0]} and "
            f"{over[-1]} deg of incidence"
        )
    return found


def _build(table: Material, carrier_hz: float, channel: Channel) -> RadarMaterial:
    if isinstance(table, SionnaItu):
        slab = SionnaSlab(
            itu_type=table.itu_type,
            thickness_m=table.thickness_m,
            scattering_coefficient=table.scattering_coefficient,
            xpd_coefficient=table.xpd_coefficient,
        )
        return slab_material(slab, carrier_hz, channel)
    permittivity = _permittivity(table, carrier_hz)
    if isinstance(table, RoughTable):
        assert permittivity is not None  # checked with the scenario
        vertical, horizontal = _rough_surfaces(table, permittivity, carrier_hz)
    else:
        vertical = horizontal = _empirical(table)
    return RadarMaterial(
        vertical=vertical,
        horizontal=horizontal,
        cross_polar=_cross_polar(table, channel),
        copolar_correlation=table.copolar_correlation,
        channel=channel,
        mirror=_mirror(table, permittivity, carrier_hz),
    )


def _cross_polar(table: SurfaceTable, channel: Channel) -> float:
    """Return the cross-polar ratio; for a circular wave, which lives by it, a typical one where none is given."""
    if table.cross_polar_db is not None:
        return from_db(table.cross_polar_db)
    return from_db(TYPICAL_CROSS_POLAR_DB) if channel in ("same", "opposite") else 0.0


def _permittivity(table: SurfaceTable, carrier_hz: float) -> complex | None:
    if table.medium is not None:
        return permittivity_of(table.medium, carrier_hz)
    return None if table.permittivity is None else complex(table.permittivity[0], -table.permittivity[1])


def _mirror(table: EmpiricalTable | RoughTable, permittivity: complex | None, carrier_hz: float) -> Mirror | None:
    if not table.specular or permittivity is None or table.rms_height_m is None:
        return None
    return Mirror(permittivity=permittivity, rms_height_m=table.rms_height_m, frequency_hz=carrier_hz)


def _empirical(table: EmpiricalTable) -> Backscatter:
    match table:
        case Lambertian():
            return LambertianBackscatter(from_db(table.nadir_sigma0_db))
        case UlabyDobson():
            return UlabyDobsonBackscatter(
                **{f"p{i}": getattr(table, f"p{i}") for i in range(1, 7)},
                min_incidence_rad=np.deg2rad(table.min_incidence_deg),
                max_incidence_rad=np.deg2rad(table.max_incidence_deg),
                source=table.source,
            )
        case MeasuredTable():
            return TableBackscatter.from_csv(table.path)
        case ConstantGamma():
            return ConstantGammaBackscatter(table.gamma)
    message = f"{table} is not a material"
    raise TypeError(message)


def _rough_surfaces(table: RoughTable, permittivity: complex, carrier_hz: float) -> tuple[Backscatter, Backscatter]:
    """Return a rough-surface model for V and for H."""
    surface = rough_surface.RoughSurface(
        permittivity=permittivity,
        rms_height_m=table.rms_height_m,
        correlation_length_m=table.correlation_length_m,
        frequency_hz=carrier_hz,
        correlation=table.correlation,
    )
    model: Callable[..., Backscatter]
    options = {}
    match table:
        case Kirchhoff():
            model = rough_surface.GeometricalOptics
        case PhysicalOptics():
            model = rough_surface.PhysicalOptics
        case SmallPerturbation():
            model = rough_surface.SmallPerturbation
        case IntegralEquation():
            model, options = rough_surface.IntegralEquation, {"fresnel_angle": table.fresnel_angle}
    return model(surface=surface, polarization="V", **options), model(surface=surface, polarization="H", **options)


def _key(name: str, table: Material, message: str) -> str:
    """Return the dotted key that a message of a formula is about: it starts with the parameter's name."""
    first = re.match(r"\w*", message)
    field = first.group() if first else ""
    if isinstance(table, SionnaItu):
        return f"{name}.itu_type"
    if field in type(table).model_fields:
        return f"{name}.{field}"
    if table.medium is not None and field in type(table.medium).model_fields:
        return f"{name}.medium.{field}"
    return f"{name}.medium" if table.medium is not None else name
