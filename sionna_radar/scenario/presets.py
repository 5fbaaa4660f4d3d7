"""Presets of published radars (`radar.preset`) and lidars (`lidar.preset`), read from `presets.toml`."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sionna_radar.foundation.input_file import parse_toml


@dataclass(frozen=True, kw_only=True)
class Preset:
    """A published radar or lidar.

    summary: description. keys: those of `[radar]` or `[lidar]`. sources: of its figures. assumed: figures without a
    source. scenario: other tables that a scenario with it begins with (`sionna-radar init`).
    """

    summary: str
    keys: Mapping[str, Any]
    sources: tuple[str, ...]
    assumed: tuple[str, ...]
    scenario: Mapping[str, Any] = field(default_factory=dict)


def _frozen(value: Any) -> Any:
    """Return a value of a TOML file with its lists as tuples."""
    if isinstance(value, dict):
        return {key: _frozen(entry) for key, entry in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


_PUBLISHED = _frozen(parse_toml(Path(__file__).with_name("presets.toml").read_text(encoding="utf-8")))
PRESETS: Mapping[str, Preset] = {name: Preset(**entry) for name, entry in _PUBLISHED["radar"].items()}
LIDAR_PRESETS: Mapping[str, Preset] = {name: Preset(**entry) for name, entry in _PUBLISHED["lidar"].items()}

# Alternative descriptions of the noise: one of the user's replaces the preset's other.
NOISE = ({"snr_db"}, {"transmit_power_dbm", "noise_figure_db"})
# A table of another kind than the preset's is not merged with it.
KINDS = {"antenna": "kind", "scan": "mode"}


def filled_in(values: Mapping[str, Any], implied: Mapping[str, str]) -> dict[str, Any]:
    """Return keys of `[radar]`, completed from its preset.

    implied: kinds of antenna by the key that implies them.
    """
    preset = copy.deepcopy(dict(PRESETS[values["preset"]].keys))
    for noise_keys, other_keys in (NOISE, NOISE[::-1]):
        if any(values.get(key) is not None for key in noise_keys):
            preset = {key: value for key, value in preset.items() if key not in other_keys}
    receiver = values.get("receiver")
    if isinstance(receiver, Mapping) and receiver.get("amplifiers"):
        preset.pop("noise_figure_db", None)
    merged = {**preset, **{key: value for key, value in values.items() if value is not None}}
    if isinstance(values.get("array"), Mapping) and "array" in preset:
        merged["array"] = {**preset["array"], **values["array"]}
    for table, tag in KINDS.items():
        table_values, preset_table = values.get(table), preset[table]
        if isinstance(table_values, Mapping):
            default_kind = next((kind for key, kind in implied.items() if key in table_values), preset_table[tag])
            same_kind = table_values.get(tag, default_kind) == preset_table[tag]
            merged[table] = {**preset_table, **table_values} if same_kind else dict(table_values)
    return merged
