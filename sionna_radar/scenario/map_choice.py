"""Default DEM method of a scenario, and its echoes."""

import math
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from sionna_radar.scenario.parts import SENSORS
from sionna_radar.scenario.radar import AntennaTable, ScanTable

# Precipitation: its echo fills the beam and would be mistaken for roofs.
FALLING = ("rain_rate_mm_per_h", "rain_cell", "rain_field", "snowfall_mm_per_h")
# Largest line spacing, in footprints: a two-way main lobe is hardly wider than two half-power widths. Strips between
# more distant lines are not illuminated, and walls there are seen from at most one side.
FARTHEST_FOOTPRINTS = 2.0


def with_map(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a scenario with defaults of `dem.method` and `processing.echoes`.

    Over buildings `dem.method` is "stepped", with all echoes of a pulse, if whole echoes are available and the lines of
    the scan are close enough; elsewhere "linear".
    """
    tables = dict(given)
    method = _value(tables, "dem", "method")
    if method in (None, "auto"):
        method = "stepped" if _built_up(tables) and _whole_echoes(tables) and _dense(tables) else "linear"
        tables = _with(tables, "dem", "method", method)
    if method == "stepped" and not _has(tables, "processing", "echoes"):
        tables = _with(tables, "processing", "echoes", "all")
    return tables


def _built_up(tables: Mapping[str, Any]) -> bool:
    kind = _value(tables, "terrain", "kind")
    return bool(tables.get("buildings") or tables.get("footprints")) or str(kind).startswith("sionna:")


def _whole_echoes(tables: Mapping[str, Any]) -> bool:
    sensor = tables.get("sensor", "radar")
    if sensor not in SENSORS or not SENSORS.entry(sensor).facts.provides_profiles:
        return False
    if _value(tables, "processing", "angle") not in (None, "off"):
        return False
    average = {"average": _value(tables, "processing", "average")}
    if _value(average, "average", "mode") == "incoherent" and _value(average, "average", "chirps") not in (None, 1):
        return False
    return _value(tables, "radar", "sweep") != "triangular" and not any(_value(tables, "weather", k) for k in FALLING)


def _dense(tables: Mapping[str, Any]) -> bool:
    """Return whether the lines of a whisk-broom scan are at most two footprints apart; True if unknown.

    The footprint is the length along the track of the elevation beam on level ground in the middle of the scan.
    """
    radar = {key: _value(tables, "radar", key) for key in ("scan", "antenna")}
    scan = ScanTable.model_fields
    if (_value(radar, "scan", "mode") or scan["mode"].default) != "whisk_broom":
        return True
    if (_value(radar, "antenna", "kind") or "taylor") != "taylor":
        return True
    beam_deg = _value(radar, "antenna", "beamwidth_deg") or AntennaTable.model_fields["beamwidth_deg"].default
    numbers = (
        _value(tables, "platform", "speed_mps"),
        _value(tables, "platform", "altitude_m"),
        _value(radar, "scan", "rotation_rpm") or scan["rotation_rpm"].default,
        _value(radar, "scan", "incidence_deg") or scan["incidence_deg"].default,
        beam_deg[-1] if isinstance(beam_deg, (list, tuple)) and beam_deg else beam_deg,
    )
    if not all(isinstance(value, (int, float)) and 0 < value < math.inf for value in numbers):
        return True
    speed_mps, altitude_m, rotation_rpm, incidence_deg, elevation_deg = numbers
    footprint_m = math.radians(elevation_deg) * altitude_m / math.cos(math.radians(min(incidence_deg, 89.0))) ** 2
    return bool(speed_mps * 60 / rotation_rpm <= FARTHEST_FOOTPRINTS * footprint_m)


def _value(tables: Mapping[str, Any], table: str, key: str) -> Any:
    """Return a value of a table, a mapping or a model; None for anything else."""
    entry = tables.get(table)
    return entry.get(key) if isinstance(entry, Mapping) else getattr(entry, key, None)


def _has(tables: Mapping[str, Any], table: str, key: str) -> bool:
    entry = tables.get(table)
    return key in entry.model_fields_set if isinstance(entry, BaseModel) else _value(tables, table, key) is not None


def _with(tables: Mapping[str, Any], table: str, key: str, value: str) -> dict[str, Any]:
    """Return the tables with a value changed; an invalid table is left to validation."""
    entry = tables.get(table, {})
    if isinstance(entry, BaseModel):
        return {**tables, table: entry.model_copy(update={key: value})}
    return {**tables, table: {**entry, key: value}} if isinstance(entry, Mapping) else dict(tables)
