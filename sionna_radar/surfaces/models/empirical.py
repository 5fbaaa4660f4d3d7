"""Constant gamma, Lambert's law, and fitted or measured curves."""

import numpy as np

from sionna_radar.foundation.decibel import from_db
from sionna_radar.scenario.materials import ConstantGamma, Lambertian, MeasuredTable, UlabyDobson
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter, LambertianBackscatter
from sionna_radar.surfaces.material import register_material
from sionna_radar.surfaces.measured_backscatter import TableBackscatter, UlabyDobsonBackscatter
from sionna_radar.surfaces.models.polarized import polarized_material
from sionna_radar.surfaces.radar_material import Channel, RadarMaterial


@register_material("constant_gamma", ConstantGamma)
def constant_gamma(table: ConstantGamma, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material of constant gamma."""
    model = ConstantGammaBackscatter(table.gamma)
    return polarized_material(table, model, model, carrier_hz, channel)


@register_material("lambertian", Lambertian)
def lambertian(table: Lambertian, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material that follows Lambert's law."""
    model = LambertianBackscatter(from_db(table.nadir_sigma0_db))
    return polarized_material(table, model, model, carrier_hz, channel)


@register_material("ulaby_dobson", UlabyDobson)
def ulaby_dobson(table: UlabyDobson, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material with a fitted curve of Ulaby and Dobson's form."""
    model = UlabyDobsonBackscatter(
        **{f"p{i}": getattr(table, f"p{i}") for i in range(1, 7)},
        min_incidence_rad=np.deg2rad(table.min_incidence_deg),
        max_incidence_rad=np.deg2rad(table.max_incidence_deg),
        source=table.source,
    )
    return polarized_material(table, model, model, carrier_hz, channel)


@register_material("table", MeasuredTable)
def measured(table: MeasuredTable, carrier_hz: float, channel: Channel) -> RadarMaterial:
    """Return a material with a measured curve."""
    model = TableBackscatter.from_csv(table.path)
    return polarized_material(table, model, model, carrier_hz, channel)
