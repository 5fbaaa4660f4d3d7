"""Loading, validation and writing of scenarios: TOML files, shipped scenarios, overrides, and input files they name.

Identifies the input files of a scenario as well, so that a resumed run can detect changes.
"""

import copy
import os
from collections.abc import Iterator, Mapping, Sequence
from glob import escape
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError
from pydantic_core import PydanticSerializationError

from sionna_radar.foundation.city_models import refuse_city_model
from sionna_radar.foundation.errors import UNNAMED, InputFileError, ScenarioError
from sionna_radar.foundation.input_file import is_address, is_file, regular_file, shown, why_not
from sionna_radar.scenario.overrides import apply_overrides, drop_conflicting_keys, read_toml, resolve_paths
from sionna_radar.scenario.presets import PRESETS
from sionna_radar.scenario.problems import nearest, translate
from sionna_radar.scenario.scenario import Scenario
from sionna_radar.scenario.shipped import scenes_directory, shipped_scenarios
from sionna_radar.scenario.table import Table


def load_scenario(path_or_name: str | Path, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """Read a scenario from a TOML file or a shipped scenario's name, with values of dotted keys replaced.

    Parameters
    ----------
    path_or_name:
        A TOML file, or the name of a shipped scenario.
    overrides:
        Values by dotted key; None removes a key, a table replaces the whole table. Conflicting keys of a shipped
        scenario are removed.

    Returns
    -------
    The validated scenario.

    Raises
    ------
    InputFileError
        The file is missing, unreadable or not TOML.
    ScenarioError
        The scenario is wrong; every problem is listed with its dotted key, value and remedy.

    Examples
    --------
    >>> load_scenario("hills", {"radar.antenna.beamwidth_deg": 4.0}).radar.antenna.beamwidth_deg
    4.0
    """
    # A copy: the caller's tables must not change.
    path, overrides = find_scenario(path_or_name), copy.deepcopy(dict(overrides or {}))
    data = read_toml(path, "scenario", "give a TOML file")
    apply_overrides(data, overrides)
    if path.parent == scenes_directory():
        drop_conflicting_keys(data, overrides)
    resolve_paths(data, path.parent)
    return parse_scenario(data, source=shown(Path(path_or_name)))


def find_scenario(path_or_name: str | Path) -> Path:
    """Return the file of a scenario given by path or by shipped name; an existing file wins.

    Raises InputFileError where there is neither.
    """
    path = Path(path_or_name)
    try:
        path.stat()
    except (OSError, ValueError) as error:
        named = scenes_directory() / f"{path_or_name}.toml"
        if path.name == str(path_or_name) and is_file(named):
            return named
        shipped = shipped_scenarios()
        raise InputFileError(
            f"{shown(path)}: no such scenario file (it {why_not(error)}), and no shipped scenario of that name; "
            f"give a path to a TOML file or one of {', '.join(shipped)}.{nearest(str(path_or_name), list(shipped))}"
        ) from error
    if path.is_dir():
        return shipped_scenarios().get(str(path_or_name), path)
    return path


def parse_scenario(data: Mapping[str, Any], source: str = UNNAMED) -> Scenario:
    """Validate a scenario given as nested tables; all problems are reported at once.

    Parameters
    ----------
    data:
        The tables, as in a TOML file: degrees, dB and metres.
    source:
        Name of the scenario in errors.

    Returns
    -------
    The validated scenario.

    Raises
    ------
    ScenarioError
        The scenario is wrong; every problem is listed with its dotted key, value and remedy.

    Examples
    --------
    >>> tables = {
    ...     "terrain": {"kind": "flat"},
    ...     "platform": {"altitude_m": 30.0, "speed_mps": 5.0},
    ...     "radar": {"snr_db": 30.0},
    ... }
    >>> parse_scenario(tables).platform.altitude_m
    30.0
    """
    try:
        return Scenario.model_validate(data).read_from(source)
    except ValidationError as error:
        raise ScenarioError(translate(error.errors(), Scenario), source) from error


def to_toml(scenario: Scenario, *, defaults: bool = True) -> str:
    """Return the resolved scenario as TOML that loads to an equal scenario.

    Parameters
    ----------
    scenario:
        The scenario; its parameters of custom parts are written, too.
    defaults:
        Whether keys that have their default are written.

    Returns
    -------
    TOML text.

    Raises
    ------
    TypeError
        A custom part has parameters that TOML cannot hold.

    Examples
    --------
    >>> "altitude_m = 50.0" in to_toml(load_scenario("hills"))
    True
    >>> "window" in to_toml(load_scenario("hills"), defaults=False)
    False
    """
    try:
        return tomli_w.dumps(scenario.model_dump(mode="json", exclude_none=True) if defaults else scenario.differing())
    except (PydanticSerializationError, ValueError) as error:
        raise TypeError(f"the scenario contains a value that TOML cannot represent: {error}") from error


# Tables of a scenario by the ending of the file that they name.
SOURCES: dict[str, tuple[str, dict[str, Any]]] = {
    **dict.fromkeys((".tif", ".tiff", ".asc", ".hgt", ".dt0", ".dt1", ".dt2", ".xyz"), ("terrain", {"kind": "raster"})),
    **dict.fromkeys((".las", ".laz"), ("terrain", {"kind": "points"})),
    **dict.fromkeys((".obj", ".ply", ".stl", ".glb", ".gltf", ".xml"), ("terrain", {"kind": "mesh"})),
    **dict.fromkeys((".ulg", ".bin", ".tlog", ".gpx", ".csv", ".trj", ".out", ".sbet"), ("platform", {})),
}


def scenario_from(sources: Sequence[str], folder: Path) -> dict[str, Any]:
    """Return a scenario, its tables, that uses files and a radar preset of the user's, with paths relative to a folder.

    Raises ScenarioError if a source is neither a preset nor a file of a known kind, or two are of one kind.
    Raises InputFileError if a file does not exist.
    """
    tables: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for source in sources:
        path = Path(source).expanduser()
        if source in PRESETS:
            table, table_values = "radar", {"preset": source}
            others = copy.deepcopy(dict(PRESETS[source].scenario))
        elif path.suffix.lower() in SOURCES:
            regular_file(path, "--from", "give a file that exists, or the name of a preset", MAX_SOURCE_BYTES)
            refuse_city_model(path, "--from")
            table, kind = SOURCES[path.suffix.lower()]
            table_values = {**kind, "log" if table == "platform" else "path": os.path.relpath(path.absolute(), folder)}
        else:
            if is_file(path):
                refuse_city_model(path, "--from")
            message = (
                f"{source!r} is neither a preset ({', '.join(PRESETS)}) nor a file that ends in {', '.join(SOURCES)}"
            )
            raise ScenarioError.of_option("--from", message)
        if table in tables:
            raise ScenarioError.of_option("--from", f"{source!r} is a second [{table}]; give one")
        tables[table] = table_values
    if tables.setdefault("terrain", {"kind": "flat"})["kind"] == "flat" and "platform" in tables:
        tables["platform"]["log_shift"] = "to_terrain"
    if "platform" not in tables:
        in_air = {"altitude_m": 50.0, "speed_mps": 10.0, "height": "terrain_following"}
        tables["platform"] = others.pop("platform", in_air)
    tables.setdefault("radar", {"snr_db": 30.0})
    # Keys without a table come first, as TOML wants them.
    document = {"description": f"Made from {', '.join(Path(source).name for source in sources)}", **others, **tables}
    parse_scenario(document)
    return document


def start_text(document: Mapping[str, Any], command: str = "run") -> str:
    """Return the tables of a scenario to start from as TOML, with a header that names the command that takes it."""
    return FROM_HEADER.format(command=command) + tomli_w.dumps(document)


MAX_SOURCE_BYTES = 200_000_000_000
FROM_HEADER = """\
# Check it with `sionna-radar validate FILE`, which prints with --all every key that could be set, and fly it with
# `sionna-radar {command} FILE`. Paths count from this file; keys that are not here have their defaults.
"""
# Formats whose files refer to other files.
NAMES_OTHERS = {".obj", ".gltf", ".xml", ".dae", ".vrt"}


def identity(scenario: Scenario, block_size: int) -> dict[str, Any]:
    """Return the inputs that determine the parts of a survey, as a JSON document."""
    return {
        "scenario": scenario.model_dump(mode="json"),
        "seed": scenario.seed,
        "block size": block_size,
        "input file": input_files(scenario),
    }


def input_files(scenario: Scenario) -> dict[str, list[int]]:
    """Return size in bytes and time of the last change, in nanoseconds, of the files that a scenario names."""
    stamps = {}
    for path in _paths(scenario.model_dump()):
        if path.is_file():
            stat = path.stat()
            stamps[str(path)] = [stat.st_size, stat.st_mtime_ns]
    return stamps


def content_key(tables: Mapping[str, Any]) -> str | None:
    """Return a text that identifies the content of some tables: their values and their files.

    For each file, and those beside it with the same stem, it contains size, inode, and the times of the last changes of
    content and metadata in nanoseconds. None if the content cannot be identified: a file that refers to others, a
    network address.
    """
    document = {name: _dumped(value) for name, value in tables.items()}
    if any(is_address(leaf) for leaf in leaves(document) if isinstance(leaf, str)):
        return None
    stamps = {}
    for path in sorted(set(_paths(document))):
        if path.suffix.lower() in NAMES_OTHERS or not path.is_file():
            return None
        for side_file in sorted(path.parent.glob(f"{escape(path.stem)}*")):
            stat = side_file.stat()
            stamps[str(side_file.resolve())] = (stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns)
    return repr((document, stamps))


def _dumped(value: Any) -> Any:
    """Return a value with its tables as plain ones, including their class names."""
    if isinstance(value, Table):
        return type(value).__module__, type(value).__qualname__, value.model_dump()
    if isinstance(value, Mapping):
        return {key: _dumped(entry) for key, entry in value.items()}
    return tuple(_dumped(entry) for entry in value) if isinstance(value, list | tuple) else value


def leaves(value: Any) -> Iterator[Any]:
    """Yield the values in nested tables and lists."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else None
    if inner is None:
        yield value
        return
    for entry in inner:
        yield from leaves(entry)


def _paths(value: Any) -> Iterator[Path]:
    return (leaf for leaf in leaves(value) if isinstance(leaf, Path))
