"""The permittivity of a scenario's medium at the carrier."""

from sionna_radar.scenario.media import Asphalt, BuildingMedium, DrySnow, Ice, Medium, Soil, Vegetation, Water
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


def permittivity_of(medium: Medium, carrier_hz: float) -> complex:
    """Return the complex permittivity of a medium; ValueError names the parameter out of range."""
    given = medium.model_dump(exclude={"kind"})
    match medium:
        case BuildingMedium():
            return building_permittivity(medium.kind, carrier_hz)
        case Soil():
            return soil_permittivity(carrier_hz, **given)
        case Water():
            return water_permittivity(carrier_hz, **given)
        case Ice():
            return ice_permittivity(carrier_hz, **given)
        case DrySnow():
            return dry_snow_permittivity(carrier_hz, **given)
        case Asphalt():
            return asphalt_permittivity(carrier_hz, **given)
        case Vegetation():
            return vegetation_permittivity(carrier_hz, **given)
    return wet_snow_permittivity(carrier_hz, **given)


def extrapolation_of(medium: Medium, carrier_hz: float) -> str | None:
    """Return a note on a formula used beyond the measurements behind it; None within them."""
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
