"""Values given beside a scenario file: read from `KEY=VALUE` or a file, and put into the file's tables.

A key is dotted, with numbers for the entries of a list. The value None takes a key out, a table replaces the whole
table. What such a value contradicts, and the user never wrote, gives way: see `give_way`.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, get_args

from sionna_radar.foundation.errors import InputFileError, Problem, ScenarioError
from sionna_radar.foundation.input_file import is_address, parse_toml, read_text, shown
from sionna_radar.scenario.materials import Medium
from sionna_radar.scenario.parts import ANTENNAS, MATERIALS, NAVIGATIONS, SCANS, TERRAINS
from sionna_radar.scenario.registry import Registry

UNSET_WORD = "none"
LONGEST_ASSIGNMENT = 100_000

# What a recorded flight takes from its log.
PLANNED_KEYS = (
    *("altitude_m", "speed_mps", "start_m", "heading_deg", "length_m", "waypoints_m", "height", "profile"),
    *("bank_deg", "turn_radius_m", "wind", "lines"),
)
# Of each pair the keys on one side contradict those on the other.
EITHER_OR = (
    (("radar.transmit_power_dbm", "radar.noise_figure_db"), ("radar.snr_db",)),
    (("radar.receiver.amplifiers",), ("radar.noise_figure_db", "radar.snr_db")),
    (("platform.waypoints_m",), ("platform.start_m", "platform.length_m", "platform.heading_deg")),
    (("platform.lines",), ("platform.start_m", "platform.length_m", "platform.waypoints_m")),
    (("platform.bank_deg",), ("platform.turn_radius_m",)),
    (("platform.log",), tuple(f"platform.{key}" for key in PLANNED_KEYS)),
    (("weather.fog",), ("weather.liquid_water_g_per_m3", "weather.fog_visibility_m")),
)
EITHER_OR_OF_A_MATERIAL = ((("gamma_db",), ("terrain_class",)), (("permittivity",), ("medium",)))
# (key, value): what means nothing beside it.
MEANINGLESS_BESIDE: dict[tuple[str, object], tuple[str, ...]] = {
    ("weather.gases", False): ("weather.dry_pressure_hpa", "weather.vapour_g_per_m3"),
    ("radar.sweep", "triangular"): ("processing.echoes",),
    ("tracing.engine", "path_solver"): ("tracing.speckle",),
    **{("radar.scan.mode", mode): ("radar.scan.side",) for mode in ("whisk_broom", "conical", "fixed")},
}


# Keys that say by themselves which antenna is meant.
IMPLIED_ANTENNAS = {"pattern": "pattern", "elements": "array"}

# Keys that select what their table holds.
TAGS = {
    "terrain.kind": TERRAINS,
    "radar.scan.mode": SCANS,
    "radar.antenna.kind": ANTENNAS,
    "platform.navigation.kind": NAVIGATIONS,
}


def parse_overrides(assignments: Iterable[str]) -> dict[str, Any]:
    """Read `KEY=VALUE` assignments: a value is TOML, a bare word is a string, and the bare word none is None.

    Raises ScenarioError for an assignment without a key or an equals sign, or with a value that no scenario holds.
    """
    overrides: dict[str, Any] = {}
    for assignment in assignments:
        key, separator, text = assignment.partition("=")
        if not separator or not key.strip():
            raise ScenarioError([Problem("--set", f"{shown(assignment)} is not KEY=VALUE")], "command line")
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
            message = f"the text has {len(text):,} characters"
            raise ValueError(message)
        return parse_toml(f"value = {text}")["value"]
    except ValueError as error:
        if _is_a_word(text):
            return text
        problem = Problem(shown(key)[1:-1], f"{shown(text)} is not a value: {error}")
        raise ScenarioError([problem], "command line") from error


def _is_a_word(text: str) -> bool:
    """Whether a text that is not TOML is a string: it opens no list or table, and is not a number."""
    word = text.strip()
    return len(text) <= LONGEST_ASSIGNMENT and not word.startswith(("[", "{", '"', "'")) and not word.isdecimal()


def read_overrides(path: Path) -> dict[str, Any]:
    """Return the values of a TOML file by their dotted keys: its tables are merged into the scenario's, lists replace.

    Relative paths of input files in it are relative to its own folder, or else to the working folder.

    Raises InputFileError where the file cannot be read, is not TOML, or names a key with a dot in it.
    """
    try:
        data = parse_toml(read_text(path, "--set-file", "give a TOML file of scenario tables"))
    except ValueError as error:
        if isinstance(error, InputFileError):
            raise
        message = f"{shown(path)}: not valid TOML: {error}; correct the file at that place"
        raise InputFileError(message) from error
    resolve_paths(data, path.parent)
    flat: dict[str, Any] = {}
    _flatten(data, "", flat, path)
    return flat


def _flatten(table: Mapping[str, Any], prefix: str, flat: dict[str, Any], path: Path) -> None:
    for key, value in table.items():
        if "." in key:
            message = f"{shown(path)}: {shown(key)} has a dot in its name and cannot be merged; rename it"
            raise InputFileError(message)
        if isinstance(value, dict) and value:
            _flatten(value, f"{prefix}{key}.", flat, path)
        else:
            flat[prefix + key] = value


def apply_overrides(data: dict[str, Any], overrides: Mapping[str, Any]) -> None:
    """Put values at dotted keys into nested tables; None takes the key out.

    Raises ScenarioError for a key that does not lead to a value.
    """
    for key, value in overrides.items():
        _set_dotted(data, key, value)


def _set_dotted(data: dict[str, Any], key: str, value: Any) -> None:
    *tables, last = key.split(".")
    node: Any = data
    for name in tables:
        node = node.setdefault(name, {}) if isinstance(node, dict) else _list_item(node, name, key)
    if isinstance(node, list):
        _list_item(node, last, key)
        if value is None:
            del node[int(last)]
        else:
            node[int(last)] = value
    elif not isinstance(node, dict):
        problem = Problem(shown(key)[1:-1], "passes through a value that is not a table; check the key")
        raise ScenarioError([problem], "overrides")
    elif value is None:
        node.pop(last, None)
    else:
        node[last] = value


def _list_item(node: Any, name: str, key: str) -> Any:
    try:
        return node[int(name)]
    except (ValueError, IndexError, TypeError) as error:
        raise ScenarioError([Problem(shown(key)[1:-1], f"{shown(name)} is not an entry there")], "overrides") from error


def give_way(data: dict[str, Any], overrides: Mapping[str, Any]) -> None:
    """Take out of a shipped scene what the user's own values, which are in it already, contradict.

    Whoever flies `hills` with a transmit power need not know that the scene is described by an `snr_db`.
    """
    for one, other in EITHER_OR:
        _give_way_to_either(data, overrides, one, other)
    materials = data.get("materials")
    for name in materials if isinstance(materials, dict) else ():
        for one, other in EITHER_OR_OF_A_MATERIAL:
            keys = ([f"materials.{name}.{key}" for key in side] for side in (one, other))
            _give_way_to_either(data, overrides, *keys)
    for (key, value), meaningless in MEANINGLESS_BESIDE.items():
        if key in overrides and overrides[key] == value:
            _drop(data, overrides, meaningless)
    antennas = [kind for own, kind in IMPLIED_ANTENNAS.items() if f"radar.antenna.{own}" in overrides]
    if antennas:
        _drop(data, overrides, ["radar.antenna.kind"])
    for key, value in [*(("radar.antenna.kind", kind) for kind in antennas), *overrides.items()]:
        known = _keys_beside(key, value)
        table = _at(data, key.rpartition(".")[0])
        if known and isinstance(table, dict):
            unknown = [f"{key.rpartition('.')[0]}.{name}" for name in table if name not in known]
            _drop(data, overrides, unknown)


def _give_way_to_either(
    data: dict[str, Any], overrides: Mapping[str, Any], one: Iterable[str], other: Iterable[str]
) -> None:
    one, other = list(one), list(other)
    for given, contradicted in ((one, other), (other, one)):
        if any(_at(data, key) is not None and _wrote(overrides, key) for key in given):
            _drop(data, overrides, contradicted)


def _drop(data: dict[str, Any], overrides: Mapping[str, Any], keys: Iterable[str]) -> None:
    for key in keys:
        if not _wrote(overrides, key):
            table = _at(data, key.rpartition(".")[0])
            if isinstance(table, dict):
                table.pop(key.rpartition(".")[2], None)


def _wrote(overrides: Mapping[str, Any], key: str) -> bool:
    """Whether the user wrote a key, a part of it, or the table that it is in."""
    return any(key == own or key.startswith(f"{own}.") or own.startswith(f"{key}.") for own in overrides)


def _at(data: Any, key: str) -> Any:
    for name in key.split("."):
        data = data.get(name) if isinstance(data, dict) else None
    return data


def _keys_beside(key: str, value: Any) -> set[str]:
    """Return the keys that a table may hold once the key that selects its kind has a value; none for any other key."""
    place = key.split(".")
    if key in TAGS:
        return _fields_of_part(TAGS[key], value)
    if place[0] == "materials" and len(place) == 3 and place[2] == "model":
        return _fields_of_part(MATERIALS, value)
    if place[0] == "materials" and place[2:] == ["medium", "kind"]:
        return _fields_of_kind(Medium, "kind", value)
    return set()


def _fields_of_part(registry: Registry, name: Any) -> set[str]:
    parameters = registry.entry(name).parameters if isinstance(name, str) and name in registry else None
    return set(parameters.model_fields) if parameters else set()


def _fields_of_kind(union: Any, tag: str, value: Any) -> set[str]:
    for member in get_args(get_args(union)[0]):
        table = get_args(member)[0] if get_args(member) else member
        if value in get_args(table.model_fields[tag].annotation):
            return set(table.model_fields)
    return set()


# Keys that name input files, in whatever table they stand.
PATH_KEYS = ("path", "log", "pattern", "receive_pattern", "element_pattern")


def resolve_paths(data: dict[str, Any], folder: Path) -> None:
    """Take relative paths of input files as relative to a folder, or else to the working folder."""
    waiting: list[Any] = [data]
    while waiting:
        node = waiting.pop()
        waiting += node.values() if isinstance(node, dict) else node if isinstance(node, list) else []
        for key in PATH_KEYS:
            if isinstance(node, dict) and isinstance(node.get(key), str):
                node[key] = _resolved(node[key], folder)


def _resolved(text: str, folder: Path) -> str:
    """Return an absolute path; what no file system takes is left for the file's reader to refuse."""
    if is_address(text):
        return text
    try:
        beside = folder / text
        return str((beside if beside.exists() else Path(text)).absolute())
    except (OSError, ValueError):
        return text
