"""Reading scenarios: TOML files or shipped names, `--set` overrides, and errors a person can act on."""

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from sionna_radar.errors import InputFileError, Problem, ScenarioError
from sionna_radar.scenario.scenario import Scenario

REMEDIES = {
    "extra_forbidden": "unknown key; remove it or correct its spelling",
    "missing": "required, but not given; add it",
}


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
    """Return the shipped scenarios by name."""
    return {path.stem: path for path in sorted(scenes_directory().glob("*.toml"))}


def load_scenario(path_or_name: str | Path, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """Read a scenario from a TOML file or a shipped scenario's name, with dotted keys replaced.

    Raises
    ------
    InputFileError
        The file is missing, unreadable or no TOML.
    ScenarioError
        The scenario is wrong; every problem is listed with its dotted key, value and remedy.

    """
    path = find_scenario(path_or_name)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        message = f"{path}: not valid TOML: {error}; correct the file at that place"
        raise InputFileError(message) from error
    except OSError as error:
        message = f"{path}: cannot be read ({error.strerror}); check the path and its permissions"
        raise InputFileError(message) from error
    for key, value in (overrides or {}).items():
        _set_dotted(data, key, value)
    _resolve_paths(data, path.parent)
    return parse_scenario(data, source=str(path_or_name))


def find_scenario(path_or_name: str | Path) -> Path:
    """Return the file of a scenario given by path or by shipped name; an existing file wins.

    Raises InputFileError where there is neither.
    """
    path = Path(path_or_name)
    if path.is_file():
        return path
    shipped = shipped_scenarios()
    if str(path_or_name) in shipped:
        return shipped[str(path_or_name)]
    message = (
        f"{path_or_name}: no such scenario file, and no shipped scenario of that name; "
        f"give a path to a TOML file or one of {', '.join(shipped)}"
    )
    raise InputFileError(message)


def parse_scenario(data: Mapping[str, Any], source: str = "scenario") -> Scenario:
    """Validate a scenario given as nested tables; all problems are reported at once.

    Raises
    ------
    ScenarioError
        The scenario is wrong; every problem is listed with its dotted key, value and remedy.

    """
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        problems = {problem.field: problem for problem in map(_problem, reversed(error.errors()))}
        raise ScenarioError(reversed(problems.values()), source) from error


def parse_overrides(assignments: Iterable[str]) -> dict[str, Any]:
    """Read `KEY=VALUE` assignments; a value is TOML, and a bare word is a string.

    Raises ScenarioError for an assignment without a key or an equals sign.
    """
    overrides: dict[str, Any] = {}
    for assignment in assignments:
        key, separator, text = assignment.partition("=")
        if not separator or not key.strip():
            raise ScenarioError([Problem("--set", f"{assignment!r} is not KEY=VALUE")], "command line")
        try:
            overrides[key.strip()] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            overrides[key.strip()] = text
    return overrides


def to_toml(scenario: Scenario) -> str:
    """Return the resolved scenario as TOML that loads to an equal scenario."""
    return tomli_w.dumps(scenario.model_dump(mode="json", exclude_none=True))


def _set_dotted(data: dict[str, Any], key: str, value: Any) -> None:
    *tables, last = key.split(".")
    node: Any = data
    for name in tables:
        node = node.setdefault(name, {}) if isinstance(node, dict) else _list_item(node, name, key)
    if isinstance(node, list):
        _list_item(node, last, key)
        node[int(last)] = value
    elif isinstance(node, dict):
        node[last] = value
    else:
        problem = Problem(key, "leads through a value that is no table; check the key")
        raise ScenarioError([problem], "overrides")


def _list_item(node: Any, name: str, key: str) -> Any:
    try:
        return node[int(name)]
    except (ValueError, IndexError, TypeError) as error:
        raise ScenarioError([Problem(key, f"{name!r} is no entry there")], "overrides") from error


def _resolve_paths(data: dict[str, Any], folder: Path) -> None:
    """Take relative paths of input files as relative to the scenario file, or else to the working folder."""
    terrain = data.get("terrain")
    tables = [terrain, terrain.get("cover_raster")] if isinstance(terrain, dict) else []
    materials = data.get("materials")
    tables += materials.values() if isinstance(materials, dict) else []
    for table in tables:
        if isinstance(table, dict) and isinstance(table.get("path"), str):
            beside = folder / table["path"]
            table["path"] = str((beside if beside.exists() else Path(table["path"])).resolve())


def _problem(error: Mapping[str, Any]) -> Problem:
    location = [str(part) for part in error["loc"]]
    if location[:1] == ["terrain"] and len(location) > 1:
        del location[1]  # the tag of the terrain kind is no key of the file
    if location[:1] == ["materials"] and len(location) > 2:
        del location[2]  # nor is the material model
        if location[2:3] == ["medium"] and len(location) > 3:
            del location[3]  # nor the kind of the medium
    if error["type"] == "scenario":
        field = error.get("ctx", {}).get("field", "")
        return Problem(".".join([*location, *([field] if field else [])]) or "scenario", error["msg"])
    if error["type"] == "union_tag_not_found":
        return Problem(".".join([*location, error["ctx"]["discriminator"].strip("'")]), REMEDIES["missing"])
    location = [part for part in location if not part.startswith(("tuple[", "constrained-", "float", "int"))]
    remedy = REMEDIES.get(error["type"])
    if remedy is None:
        given = error["input"]
        remedy = f"{given!r} is refused: {error['msg'][0].lower()}{error['msg'][1:]}"
    return Problem(".".join(location), remedy)
