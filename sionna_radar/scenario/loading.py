"""Reading of scenarios from TOML files or shipped names, with overrides and actionable errors.

Identifies the input files of a scenario as well, so that a resumed run can detect changes.
"""

import copy
from collections.abc import Iterator, Mapping
from glob import escape
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError
from pydantic_core import PydanticSerializationError

from sionna_radar.foundation.errors import UNNAMED, InputFileError, ScenarioError
from sionna_radar.foundation.input_file import is_address, parse_toml, read_text, shown, why_not
from sionna_radar.scenario.overrides import apply_overrides, give_way, resolve_paths
from sionna_radar.scenario.problems import nearest, translate
from sionna_radar.scenario.scenario import Scenario
from sionna_radar.scenario.table import Table


def scenes_directory() -> Path:
    """Return the folder of shipped scenarios: inside the wheel, or beside the package in a checkout.

    Raises InputFileError where the installation lacks it.
    """
    package = Path(__file__).resolve().parents[1]
    for candidate in (package / "scenes", package.parent / "scenes"):
        if candidate.is_dir():
            return candidate
    message = f"the shipped scenarios are missing beside {package}; install the package again"
    raise InputFileError(message)


def shipped_scenarios() -> dict[str, Path]:
    """Return the files of the shipped scenarios by name.

    Examples
    --------
    >>> "hills" in shipped_scenarios()
    True

    """
    return {path.stem: path for path in sorted(scenes_directory().glob("*.toml"))}


def load_scenario(path_or_name: str | Path, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """Read a scenario from a TOML file or a shipped scenario's name, with values of dotted keys replaced.

    Parameters
    ----------
    path_or_name:
        A TOML file, or the name of a shipped scenario.
    overrides:
        Values by dotted key; None removes a key, a table replaces the whole table. Conflicting keys of a shipped
        scenario are removed.

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
    try:
        data = parse_toml(read_text(path, "scenario", "give a TOML file"))
    except ValueError as error:
        if isinstance(error, InputFileError):
            raise
        message = f"{shown(path)}: not valid TOML: {error}; correct the file at that place"
        raise InputFileError(message) from error
    apply_overrides(data, overrides)
    if path in shipped_scenarios().values():
        give_way(data, overrides)
    resolve_paths(data, path.parent)
    return parse_scenario(data, source=shown(Path(path_or_name)))


def find_scenario(path_or_name: str | Path) -> Path:
    """Return the file of a scenario given by path or by shipped name; an existing file wins.

    Raises InputFileError where there is neither.
    """
    shipped, path = shipped_scenarios(), Path(path_or_name)
    try:
        path.stat()
    except (OSError, ValueError) as error:
        if str(path_or_name) in shipped:
            return shipped[str(path_or_name)]
        message = (
            f"{shown(path)}: no such scenario file (it {why_not(error)}), and no shipped scenario of that name; "
            f"give a path to a TOML file or one of {', '.join(shipped)}.{nearest(str(path_or_name), list(shipped))}"
        )
        raise InputFileError(message) from error
    if path.is_dir() and str(path_or_name) in shipped:
        return shipped[str(path_or_name)]
    return path


def parse_scenario(data: Mapping[str, Any], source: str = UNNAMED) -> Scenario:
    """Validate a scenario given as nested tables; all problems are reported at once.

    Parameters
    ----------
    data:
        The tables, as in a TOML file: degrees, dB and metres.
    source:
        Name of the scenario in errors.

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


def to_toml(scenario: Scenario) -> str:
    """Return the resolved scenario as TOML that loads to an equal scenario.

    Parameters
    ----------
    scenario:
        The scenario; its parameters of custom parts are written, too.

    Raises
    ------
    TypeError
        A custom part has parameters that TOML cannot hold.

    Examples
    --------
    >>> "altitude_m = 50.0" in to_toml(load_scenario("hills"))
    True

    """
    try:
        return tomli_w.dumps(scenario.model_dump(mode="json", exclude_none=True))
    except (PydanticSerializationError, ValueError) as error:
        message = f"the scenario holds a value that TOML cannot: {error}"
        raise TypeError(message) from error


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
    if any(is_address(leaf) for leaf in _leaves(document) if isinstance(leaf, str)):
        return None
    stamps = {}
    for path in sorted(set(_paths(document))):
        if path.suffix.lower() in NAMES_OTHERS or not path.is_file():
            return None
        for beside in sorted(path.parent.glob(f"{escape(path.stem)}*")):
            stat = beside.stat()
            stamps[str(beside.resolve())] = (stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns)
    return repr((document, stamps))


def _dumped(value: Any) -> Any:
    """Return a value with its tables as plain ones, including their class names."""
    if isinstance(value, Table):
        return type(value).__module__, type(value).__qualname__, value.model_dump()
    if isinstance(value, Mapping):
        return {key: _dumped(entry) for key, entry in value.items()}
    return tuple(_dumped(entry) for entry in value) if isinstance(value, list | tuple) else value


def _leaves(value: Any) -> Iterator[Any]:
    """Yield the values within nested tables and lists."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else None
    if inner is None:
        yield value
        return
    for entry in inner:
        yield from _leaves(entry)


def _paths(value: Any) -> Iterator[Path]:
    return (leaf for leaf in _leaves(value) if isinstance(leaf, Path))
