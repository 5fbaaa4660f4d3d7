"""The DEM method that a scenario gets without naming one, and the echoes that go with it."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from sionna_radar.scenario.parts import SENSORS

# Beside precipitation, whose echo fills the beam, parts of it would be taken for roofs.
FALLING = ("rain_rate_mm_per_h", "rain_cell", "rain_field", "snowfall_mm_per_h")


def with_map(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a scenario with `dem.method` chosen if it is "auto" or missing, and `processing.echoes`.

    Over buildings it is "stepped", with all echoes of a pulse, if whole echoes are to be had; elsewhere "linear".
    """
    tables = dict(given)
    method = _value(tables, "dem", "method")
    if method in (None, "auto"):
        method = "stepped" if _built_up(tables) and _whole_echoes(tables) else "linear"
        tables = _with(tables, "dem", "method", method)
    if method == "stepped" and not _has(tables, "processing", "echoes"):
        tables = _with(tables, "processing", "echoes", "all")
    return tables


def _built_up(tables: Mapping[str, Any]) -> bool:
    kind = _value(tables, "terrain", "kind")
    return bool(tables.get("buildings") or tables.get("footprints")) or str(kind).startswith("sionna:")


def _whole_echoes(tables: Mapping[str, Any]) -> bool:
    sensor = tables.get("sensor", "radar")
    if sensor not in SENSORS or not SENSORS.entry(sensor).provides_profiles:
        return False
    return _value(tables, "radar", "sweep") != "triangular" and not any(_value(tables, "weather", k) for k in FALLING)


def _value(tables: Mapping[str, Any], table: str, key: str) -> Any:
    """Return a value of a table, be it read from a file or a model; None where it is neither."""
    found = tables.get(table)
    return found.get(key) if isinstance(found, Mapping) else getattr(found, key, None)


def _has(tables: Mapping[str, Any], table: str, key: str) -> bool:
    found = tables.get(table)
    return key in found.model_fields_set if isinstance(found, BaseModel) else _value(tables, table, key) is not None


def _with(tables: Mapping[str, Any], table: str, key: str, value: str) -> dict[str, Any]:
    """Return the tables with a value changed; a table that is none is left to be refused."""
    found = tables.get(table, {})
    if isinstance(found, BaseModel):
        return {**tables, table: found.model_copy(update={key: value})}
    return {**tables, table: {**found, key: value}} if isinstance(found, Mapping) else dict(tables)
