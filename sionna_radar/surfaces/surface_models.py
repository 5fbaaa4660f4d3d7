"""Backscatter models by name: constant gamma, Lambert's law, fitted and measured curves, rough surfaces."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sionna_radar.foundation.numerics import from_db
from sionna_radar.scenario.materials import (
    ConstantGamma,
    EmpiricalTable,
    IntegralEquation,
    Kirchhoff,
    Lambertian,
    MeasuredTable,
    PhysicalOptics,
    RoughTable,
    SmallPerturbation,
    UlabyDobson,
)
from sionna_radar.surfaces import rough_surface
from sionna_radar.surfaces import rough_surface as integral_equation_model
from sionna_radar.surfaces.backscatter import (
    Backscatter,
    ConstantGammaBackscatter,
    LambertianBackscatter,
    TableBackscatter,
    UlabyDobsonBackscatter,
)
from sionna_radar.surfaces.material import permittivity_of
from sionna_radar.surfaces.radar_material import Channel, Mirror, RadarMaterial, typical_cross_polar


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
    return _rough(
        integral_equation_model.IntegralEquationModel, table, carrier_hz, channel, fresnel_angle=table.fresnel_angle
    )


def _rough(
    model: Callable[..., Backscatter], table: RoughTable, carrier_hz: float, channel: Channel, **options: Any
) -> RadarMaterial:
    permittivity = table_permittivity(table, carrier_hz)
    assert permittivity is not None  # checked with the scenario
    surface = rough_surface.RoughSurface(
        permittivity=permittivity,
        rms_height_m=table.rms_height_m,
        correlation_length_m=table.correlation_length_m,
        frequency_hz=carrier_hz,
        correlation=table.correlation,
    )
    vertical, horizontal = (model(surface=surface, polarization=p, **options) for p in "VH")
    return polarized_material(table, vertical, horizontal, carrier_hz, channel)
