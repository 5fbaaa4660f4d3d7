"""Overrides of a scenario: parsing of `KEY=VALUE` and override files, and merging into its tables.

A key is dotted, with numbers for the entries of a list. The value None removes a key, a table replaces the whole
table. Conflicting keys not written by the user are removed: see `drop_conflicting_keys`.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, get_args

from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import is_address, parse_toml, read_text, shown
from sionna_radar.scenario.materials import Medium
from sionna_radar.scenario.parts import (
    ANTENNAS,
    DEM_METHODS,
    ENGINES,
    MATERIALS,
    NAVIGATIONS,
    RANGE_ESTIMATORS,
    SCANS,
    SENSORS,
    TERRAINS,
)
from sionna_radar.scenario.registry import Registry

UNSET_WORD = "none"
LONGEST_ASSIGNMENT = 100_000

# Keys replaced by the log of a recorded flight.
PLAN_KEYS = (
    *("altitude_m", "speed_mps", "start_m", "heading_deg", "length_m", "waypoints_m", "height", "profile"),
    *("bank_deg", "turn_radius_m", "wind", "lines"),
)
# Pairs of mutually exclusive sets of keys.
EXCLUSIVE_KEYS = (
    (("radar.transmit_power_dbm", "radar.noise_figure_db"), ("radar.snr_db",)),
    (("radar.receiver.amplifiers",), ("radar.noise_figure_db", "radar.snr_db")),
    (("platform.waypoints_m",), ("platform.start_m", "platform.length_m", "platform.heading_deg")),
    (("platform.lines",), ("platform.start_m", "platform.length_m", "platform.waypoints_m")),
    (("platform.bank_deg",), ("platform.turn_radius_m",)),
    (("platform.log",), tuple(f"platform.{key}" for key in PLAN_KEYS)),
    (("weather.fog",), ("weather.liquid_water_g_per_m3", "weather.fog_visibility_m")),
)
EXCLUSIVE_MATERIAL_KEYS = ((("gamma_db",), ("terrain_class",)), (("permittivity",), ("medium",)))
# Keys without effect, by key and value.
IGNORED_WITH: dict[tuple[str, object], tuple[str, ...]] = {
    ("weather.gases", False): ("weather.dry_pressure_hpa", "weather.vapour_g_per_m3"),
    ("radar.sweep", "triangular"): ("processing.echoes",),
    ("tracing.engine", "path_solver"): ("tracing.speckle",),
    **{("radar.scan.mode", mode): ("radar.scan.side",) for mode in ("whisk_broom", "conical", "fixed")},
}


# Keys that imply the kind of antenna.
IMPLIED_ANTENNAS = {"pattern": "pattern", "elements": "array"}

# Keys that name a part with a table of parameters beside it.
NAMED = {
    "dem.method": ("dem.method_parameters", DEM_METHODS),
    "processing.ranging": ("processing.ranging_parameters", RANGE_ESTIMATORS),
    "tracing.engine": ("tracing.engine_parameters", ENGINES),
    "sensor": ("sensor_parameters", SENSORS),
}
# Keys that select the kind of their table.
TAGS = {
    "terrain.kind": TERRAINS,
    "radar.scan.mode": SCANS,
    "radar.antenna.kind": ANTENNAS,
    "platform.navigation.kind": NAVIGATIONS,
}


def parse_overrides(assignments: Iterable[str]) -> dict[str, Any]:
    """Return the values of `KEY=VALUE` assignments by dotted key, as `load_scenario` takes them.

    A value is TOML, a bare word is a string, and the bare word none is None. ScenarioError for an assignment without a
    key or an equals sign, or a value that no scenario can hold.
    """
    overrides: dict[str, Any] = {}
    for assignment in assignments:
        key, separator, text = assignment.partition("=")
        if not separator or not key.strip():
            raise ScenarioError.of_option("--set", f"{shown(assignment)} is not KEY=VALUE")
        overrides[key.strip()] = parse_value(key.strip(), text)
    return overrides


def parse_value(key: str, text: str) -> Any:
    """Return the value of a text: TOML, or else the text itself; None for the bare word none.

    Raises ScenarioError for a value that no scenario holds.
    """
    if text.strip() == UNSET_WORD:
        return None
    try:
        if len(text) > LONGEST_ASSIGNMENT:
            raise ValueError(f"the text has {len(text):,} characters")
        return parse_toml(f"value = {text}")["value"]
    except ValueError as error:
        if _is_a_word(text):
            return text
        raise ScenarioError.of_option(shown(key)[1:-1], f"{shown(text)} is not a value: {error}") from error


def _is_a_word(text: str) -> bool:
    """Whether a text that is not TOML is a string: it opens no list or table, and is not a number."""
    word = text.strip()
    return len(text) <= LONGEST_ASSIGNMENT and not word.startswith(("[", "{", '"', "'")) and not word.isdecimal()


def read_toml(path: Path, name: str, remedy: str) -> dict[str, Any]:
    """Return the tables of a file, which `name` asked for; InputFileError if it cannot be read, or is not TOML."""
    text = read_text(path, name, remedy)
    try:
        return parse_toml(text)
    except ValueError as error:
        raise InputFileError(f"{shown(path)}: not valid TOML: {error}; correct the file there") from error


def read_overrides(path: Path) -> dict[str, Any]:
    """Return the values of a TOML file by their dotted keys: its tables are merged into the scenario's, lists replace.

    Relative paths of input files in it are relative to its own folder, or else to the working folder.

    Raises InputFileError where the file cannot be read, is not TOML, or names a key with a dot in it.
    """
    data = read_toml(path, "--set-file", "give a TOML file of scenario tables")
    resolve_paths(data, path.parent)
    flat: dict[str, Any] = {}
    _flatten(data, "", flat, path)
    return flat


def _flatten(table: Mapping[str, Any], prefix: str, flat: dict[str, Any], path: Path) -> None:
    for key, value in table.items():
        if "." in key:
            raise InputFileError(f"{shown(path)}: {shown(key)} has a dot in its name and cannot be merged; rename it")
        if isinstance(value, dict) and value:
            _flatten(value, f"{prefix}{key}.", flat, path)
        else:
            flat[prefix + key] = value


def apply_overrides(data: dict[str, Any], overrides: Mapping[str, Any]) -> None:
    """Set values at dotted keys of nested tables; None removes the key.

    Parameters of a part beside its name give way to another name.

    Raises ScenarioError for a key that does not lead to a value.
    """
    for key, value in overrides.items():
        _set_dotted(data, key, value)
    for key, (place, registry) in NAMED.items():
        parameters = _lookup(data, place)
        if key in overrides and isinstance(parameters, dict):
            allowed = _fields_of(registry, overrides[key])
            _drop(data, overrides, [f"{place}.{name}" for name in parameters if name not in allowed])
            if not parameters:
                _drop(data, overrides, [place])


def _set_dotted(data: dict[str, Any], key: str, value: Any) -> None:
    *tables, final = key.split(".")
    node: Any = data
    for name in tables:
        node = node.setdefault(name, {}) if isinstance(node, dict) else _list_item(node, name, key)
    if isinstance(node, list):
        _list_item(node, final, key)
        if value is None:
            del node[int(final)]
        else:
            node[int(final)] = value
    elif not isinstance(node, dict):
        message = "leads through a value that is not a table; check the key"
        raise ScenarioError.of(shown(key)[1:-1], message, "overrides")
    elif value is None:
        node.pop(final, None)
    else:
        node[final] = value


def _list_item(node: Any, name: str, key: str) -> Any:
    try:
        return node[int(name)]
    except (ValueError, IndexError, TypeError) as error:
        message = f"{shown(name)} is not an index of an entry; check the key"
        raise ScenarioError.of(shown(key)[1:-1], message, "overrides") from error


def drop_conflicting_keys(data: dict[str, Any], overrides: Mapping[str, Any]) -> None:
    """Remove keys of a shipped scenario that conflict with user overrides already applied to it.

    For example, a transmit power for `hills` removes the scenario's `snr_db`.
    """
    for side_1, side_2 in EXCLUSIVE_KEYS:
        _drop_excluded(data, overrides, side_1, side_2)
    materials = data.get("materials")
    for name in materials if isinstance(materials, dict) else ():
        for side_1, side_2 in EXCLUSIVE_MATERIAL_KEYS:
            keys = ([f"materials.{name}.{key}" for key in side] for side in (side_1, side_2))
            _drop_excluded(data, overrides, *keys)
    for (key, value), meaningless in IGNORED_WITH.items():
        if key in overrides and overrides[key] == value:
            _drop(data, overrides, meaningless)
    antennas = [kind for antenna_key, kind in IMPLIED_ANTENNAS.items() if f"radar.antenna.{antenna_key}" in overrides]
    if antennas:
        _drop(data, overrides, ["radar.antenna.kind"])
    for key, value in [*(("radar.antenna.kind", kind) for kind in antennas), *overrides.items()]:
        allowed = _keys_of_kind(key, value)
        table = _lookup(data, key.rpartition(".")[0])
        if allowed and isinstance(table, dict):
            foreign = [f"{key.rpartition('.')[0]}.{name}" for name in table if name not in allowed]
            _drop(data, overrides, foreign)


def _drop_excluded(
    data: dict[str, Any], overrides: Mapping[str, Any], side_1: Iterable[str], side_2: Iterable[str]
) -> None:
    side_1, side_2 = list(side_1), list(side_2)
    for written, contradicted in ((side_1, side_2), (side_2, side_1)):
        if any(_lookup(data, key) is not None and _is_set(overrides, key) for key in written):
            _drop(data, overrides, contradicted)


def _drop(data: dict[str, Any], overrides: Mapping[str, Any], keys: Iterable[str]) -> None:
    for key in keys:
        if not _is_set(overrides, key):
            table = _lookup(data, key.rpartition(".")[0])
            if isinstance(table, dict):
                table.pop(key.rpartition(".")[2], None)


def _is_set(overrides: Mapping[str, Any], key: str) -> bool:
    """Whether the user wrote a key, a part of it, or its table."""
    return any(
        key == override or key.startswith(f"{override}.") or override.startswith(f"{key}.") for override in overrides
    )


def _lookup(data: Any, key: str) -> Any:
    for name in key.split("."):
        data = data.get(name) if isinstance(data, dict) else None
    return data


def value_at(scenario: object, key: str) -> Any:
    """Return the value under a dotted key of a scenario; None without one."""
    value: Any = scenario
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else getattr(value, part, None)
    return value


def _keys_of_kind(key: str, value: Any) -> set[str]:
    """Return the keys allowed in a table of the kind selected by a key's value; none for any other key."""
    parts = key.split(".")
    if key in TAGS:
        return _fields_of(TAGS[key], value)
    if parts[0] == "materials" and len(parts) == 3 and parts[2] == "model":
        return _fields_of(MATERIALS, value)
    if parts[0] == "materials" and parts[2:] == ["medium", "kind"]:
        return _fields_of_medium(value)
    return set()


def _fields_of(registry: Registry, name: Any) -> set[str]:
    parameters = registry.entry(name).parameters if isinstance(name, str) and name in registry else None
    return set(parameters.model_fields) if parameters else set()


def _fields_of_medium(kind: Any) -> set[str]:
    for member in get_args(get_args(Medium)[0]):
        table = get_args(member)[0] if get_args(member) else member
        if kind in get_args(table.model_fields["kind"].annotation):
            return set(table.model_fields)
    return set()


# Keys of input files in any table.
PATH_KEYS = ("path", "log", "pattern", "receive_pattern", "element_pattern")


def resolve_paths(data: dict[str, Any], folder: Path) -> None:
    """Resolve relative paths of input files against a folder, or else the working folder."""
    waiting: list[Any] = [data]
    while waiting:
        node = waiting.pop()
        waiting += node.values() if isinstance(node, dict) else node if isinstance(node, list) else []
        for key in PATH_KEYS:
            if isinstance(node, dict) and isinstance(node.get(key), str):
                node[key] = _resolved(node[key], folder)


def _resolved(text: str, folder: Path) -> str:
    """Return an absolute path; invalid paths are left to the file's reader."""
    if is_address(text):
        return text
    try:
        in_folder = folder / text
        return str((in_folder if in_folder.exists() else Path(text)).absolute())
    except (OSError, ValueError):
        return text
