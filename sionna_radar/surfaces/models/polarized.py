"""Common parts of all surface models: cross-polar echo, mirror reflection, and permittivity."""

from sionna_radar.foundation.decibel import from_db
from sionna_radar.scenario.materials import EmpiricalTable, RoughTable
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.medium import permittivity_of
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
