"""Reading scenarios: TOML files or shipped names, values beside them, and errors a person can act on."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError
from pydantic_core import PydanticSerializationError

from sionna_radar.foundation.errors import UNNAMED, InputFileError, ScenarioError
from sionna_radar.foundation.input_file import parse_toml, read_text, shown, why_not
from sionna_radar.scenario.overrides import apply_overrides, give_way, parse_overrides, read_overrides, resolve_paths
from sionna_radar.scenario.problems import nearest, translate
from sionna_radar.scenario.scenario import Scenario

__all__ = [
    "find_scenario",
    "load_scenario",
    "parse_overrides",
    "parse_scenario",
    "read_overrides",
    "scenes_directory",
    "shipped_scenarios",
    "to_toml",
]


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
        Values by dotted key; None takes a key out, a table replaces the whole table. What they contradict in a
        shipped scenario gives way.

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
    # A copy: what is put into the tables must not come back to the caller.
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
        What an error calls the scenario.

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
