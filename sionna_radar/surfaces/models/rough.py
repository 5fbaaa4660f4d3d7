"""Randomly rough surfaces of a homogeneous medium."""

from collections.abc import Callable
from typing import Any

from sionna_radar.scenario.materials import IntegralEquation, Kirchhoff, PhysicalOptics, RoughTable, SmallPerturbation
from sionna_radar.surfaces import integral_equation as integral_equation_model
from sionna_radar.surfaces import rough_surface
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.material import register_material
from sionna_radar.surfaces.models.polarized import polarized_material, table_permittivity
from sionna_radar.surfaces.radar_material import Channel, RadarMaterial


@register_material("kirchhoff", Kirchhoff)
def kirchhoff(table: Kirchhoff, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material that follows geometrical optics."""
    return _rough(rough_surface.GeometricalOptics, table, carrier_hz, channel)


@register_material("physical_optics", PhysicalOptics)
def physical_optics(table: PhysicalOptics, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material that follows Kirchhoff's scalar series."""
    return _rough(rough_surface.PhysicalOptics, table, carrier_hz, channel)


@register_material("small_perturbation", SmallPerturbation)
def small_perturbation(table: SmallPerturbation, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material that scatters by Bragg's resonance."""
    return _rough(rough_surface.SmallPerturbation, table, carrier_hz, channel)


@register_material("integral_equation", IntegralEquation)
def integral_equation(table: IntegralEquation, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material that follows the integral-equation model."""
    return _rough(
        integral_equation_model.IntegralEquation, table, carrier_hz, channel, fresnel_angle=table.fresnel_angle
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
