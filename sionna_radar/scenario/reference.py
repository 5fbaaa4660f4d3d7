"""JSON Schema and Markdown reference of all scenario keys, generated from the tables.

With the schema, editors complete keys, describe them and mark misspelt ones.
"""

import ast
import inspect
import json
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from sionna_radar.foundation.input_file import compact
from sionna_radar.scenario.compatibility import EXCLUSIONS, excluded_with
from sionna_radar.scenario.scenario import Scenario
from sionna_radar.scenario.table import LARGEST, summary, unit_of

# Names of bounds in pydantic's function validators and in JSON Schema.
BOUNDS = {"ge": "minimum", "le": "maximum", "gt": "exclusiveMinimum", "lt": "exclusiveMaximum"}


class _WithMeanings(GenerateJsonSchema):
    """Add the descriptions of tables and keys, and omit the implausibly large default bounds."""

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """Return the schema of a table with its description and those of its keys."""
        json_schema = super().model_schema(schema)
        table = schema["cls"]
        if issubclass(table, BaseModel):
            json_schema["description"], meaning = summary(table), meanings(table)
            for name, entry in json_schema.get("properties", {}).items():
                unit = f" ({unit_of(name)})" if unit_of(name) else ""
                selects = json_schema["description"].partition("\n")[0] if name == "kind" else ""
                if text := entry.get("description") or meaning.get(name) or selects:
                    entry["description"] = " ".join(text.split()) + unit
                entry.pop("title", None)
        return json_schema

    def float_schema(self, schema: core_schema.FloatSchema) -> JsonSchemaValue:
        """Return the schema of a number without the default bounds."""
        json_schema = super().float_schema(schema)
        return {key: value for key, value in json_schema.items() if key not in BOUNDS.values() or abs(value) < LARGEST}


def meanings(table: type[BaseModel]) -> dict[str, str]:
    """Return the docstrings of the fields of a table and of the tables it extends; none without source code."""
    parts = reversed(table.__mro__[: table.__mro__.index(BaseModel)])
    return {name: meaning for part in parts for name, meaning in _declared_meanings(part).items()}


@cache
def _declared_meanings(table: type) -> dict[str, str]:
    """Return the docstrings of the fields that a class itself declares; most of the time of a schema without cache."""
    try:
        body = ast.parse(textwrap.dedent(inspect.getsource(table))).body[0].body  # type: ignore[attr-defined]
    except (OSError, TypeError):  # made in an interactive session
        return {}
    by_name: dict[str, str] = {}
    for field, text in pairwise(body):
        match field, text:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(meaning))):
                by_name[name] = meaning
    return by_name


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a scenario, with installed or registered custom parts.

    Examples
    --------
    >>> from sionna_radar.scenario.reference import scenario_schema
    >>> "platform" in scenario_schema()["required"]
    True
    """
    json_schema = _of_toml(Scenario.model_json_schema(schema_generator=_WithMeanings))
    _add_exclusions(json_schema)
    return {"$schema": GenerateJsonSchema.schema_dialect, **json_schema, "title": "sionna_radar scenario"}


def _of_toml(schema: Any) -> Any:
    """Return a schema in which nothing may be null, as in TOML, and every bound has the standard's name."""
    if isinstance(schema, list):
        return [_of_toml(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    converted = {
        BOUNDS.get(key, key): _of_toml(value) for key, value in schema.items() if (key, value) != ("default", None)
    }
    kinds = [kind for kind in converted.get("anyOf", []) if kind != {"type": "null"}]
    if len(kinds) == 1:
        del converted["anyOf"]
        return kinds[0] | converted
    return converted | ({"anyOf": kinds} if kinds else {})


def _add_exclusions(schema: dict[str, Any]) -> None:
    for key in dict.fromkeys(setting.key for row in EXCLUSIONS for setting in (row.setting, row.other)):
        *tables, name = key.split(".")
        places = [schema]
        for table in tables:
            entries = [place["properties"][table] for place in places if table in place["properties"]]
            places = [_resolved(kind, schema["$defs"]) for entry in entries for kind in _kinds(entry)]
        unit = f" ({unit_of(name)})" if unit_of(name) else ""
        for entry in (place["properties"][name] for place in places if name in place.get("properties", {})):
            text = entry.get("description", "").removesuffix(unit)
            entry["description"] = f"{text} Not with {', '.join(dict.fromkeys(excluded_with(key)))}.{unit}".lstrip()


def _kinds(entry: Mapping[str, Any]) -> Sequence[dict[str, Any]]:
    return entry.get("anyOf", entry.get("oneOf", [entry]))


NONE = "-"


@dataclass(frozen=True, kw_only=True)
class Key:
    """A key of a table: allowed values, unit, default as TOML (both empty for none), and meaning."""

    name: str
    values: str
    unit: str
    default: str
    meaning: str
    required: bool


@dataclass(frozen=True, kw_only=True)
class Section:
    """A table of a scenario: its position, such as `[radar.antenna]`, and the key and values that select it."""

    place: str
    chosen: str
    about: str
    keys: tuple[Key, ...]


def sections() -> list[Section]:
    """Return all tables of a scenario, the scenario itself first, each once per position."""
    return _sections_of(scenario_schema())


def _sections_of(schema: Mapping[str, Any]) -> list[Section]:
    walked = _walk(schema, "", "", schema["$defs"], ())
    return list({(section.place, section.chosen): section for section in walked}.values())


def dotted_keys() -> list[str]:
    """Return all dotted keys of `--set`, without those of lists and of tables with user-defined names."""
    # Without meanings, which are read in the source code: `--set` is completed in half the time.
    tables = _sections_of(_of_toml(Scenario.model_json_schema()))
    named_sections = [(section.place.strip("[]"), section) for section in tables if not section.place.startswith("[[")]
    keys = [f"{place}.{key.name}".lstrip(".") for place, section in named_sections for key in section.keys]
    return list(dict.fromkeys(key for key in keys if "NAME" not in key))


def reference() -> str:
    """Return the reference of all keys as Markdown: a heading for each table, and a table of its keys below it.

    Examples
    --------
    >>> from sionna_radar.scenario.reference import reference
    >>> "## `[platform]`" in reference()
    True
    """
    lines = []
    for section in sections():
        heading = f"`{section.place}`" if section.place else "Top level"
        level = "##" if not section.chosen else "###"
        lines.append(f"{level} {heading}{' with ' + section.chosen if section.chosen else ''}\n\n{section.about}\n")
        lines.append("| key | value | unit | default | meaning |\n|---|---|---|---|---|")
        lines.append("\n".join(_row(key) for key in section.keys) + "\n")
    return "\n".join(lines)


def _row(key: Key) -> str:
    default = "required" if key.required else f"`{key.default}`" if key.default else NONE
    cells = (f"`{key.name}`", key.values, key.unit or NONE, default, key.meaning)
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"


def _walk(
    schema: Mapping[str, Any], place: str, chosen: str, defs: Mapping[str, Any], ancestors: tuple[str, ...]
) -> Iterator[Section]:
    required = schema.get("required", [])
    properties = schema.get("properties", {})
    yield Section(
        place=place,
        chosen=chosen,
        about=schema.get("description", ""),
        keys=tuple(
            Key(
                name=name,
                values=_values(entry, defs),
                unit=unit_of(name),
                default="" if name in required else _toml(entry.get("default")),
                meaning=entry.get("description", "").removesuffix(f" ({unit_of(name)})"),
                required=name in required,
            )
            for name, entry in properties.items()
        ),
    )
    for name, entry in properties.items():
        yield from _inside(name, entry, place, defs, ancestors)


def _inside(
    name: str, entry: Mapping[str, Any], place: str, defs: Mapping[str, Any], ancestors: tuple[str, ...]
) -> Iterator[Section]:
    """Yield the tables that a key may hold."""
    path = place.strip("[]")
    inner = f"{path}.{name}" if path else name
    heading = f"[{inner}]"
    if "items" in entry:
        entry, heading = entry["items"], f"[[{inner}]]"
    elif "additionalProperties" in entry and isinstance(entry["additionalProperties"], dict):
        entry, heading = entry["additionalProperties"], f"[{inner}.NAME]"
    tables = [_resolved(kind, defs) for kind in _kinds(entry)]
    for table in tables:
        title = table.get("title", "")
        if "properties" in table and title not in ancestors:
            chosen = _chosen(table) if len(tables) > 1 or "$comment" in table else ""
            yield from _walk(table, heading, chosen, defs, (*ancestors, title))


def _chosen(table: Mapping[str, Any]) -> str:
    """Return the key and values that select a table among those of its place."""
    if "$comment" in table:
        return str(table["$comment"])
    for tag in ("kind", "mode", "model"):
        entry = table["properties"].get(tag, {})
        names = entry.get("enum") or ([entry["const"]] if "const" in entry else [])
        if names:
            return f"`{tag}` = " + ", ".join(f'`"{name}"`' for name in names)
    return ""


def _resolved(schema: Mapping[str, Any], defs: Mapping[str, Any]) -> Any:
    return defs[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema


def _values(entry: Mapping[str, Any], defs: Mapping[str, Any]) -> str:
    """Return the allowed values of a key, in words."""
    entry = _resolved(entry, defs)
    kinds = entry.get("anyOf", entry.get("oneOf"))
    if kinds:
        return " or ".join(dict.fromkeys(_values(kind, defs) for kind in kinds))
    if "enum" in entry:
        return ", ".join(f'`"{name}"`' if isinstance(name, str) else f"`{name}`" for name in entry["enum"])
    if "const" in entry:
        return f'`"{entry["const"]}"`'
    match entry.get("type"):
        case "number" | "integer":
            kind = "number" if entry["type"] == "number" else "whole number"
            return f"{kind}{_range(entry)}"
        case "boolean":
            return "`true` or `false`"
        case "string":
            return "file" if entry.get("format") == "path" else "text"
        case "array" if "prefixItems" in entry:
            return "[" + ", ".join(_values(item, defs) for item in entry["prefixItems"]) + "]"
        case "array":
            return f"list of {_values(entry.get('items', {}), defs)}"
    if "properties" not in entry and isinstance(entry.get("additionalProperties"), dict):
        return f"table: names to {_values(entry['additionalProperties'], defs)}"
    return "table"


def _range(entry: Mapping[str, Any]) -> str:
    lower = entry.get("minimum", entry.get("exclusiveMinimum"))
    upper = entry.get("maximum", entry.get("exclusiveMaximum"))
    if lower is None and upper is None:
        return ""
    lower_text = "" if lower is None else f"{'more than ' * ('exclusiveMinimum' in entry)}{compact(lower)}"
    upper_text = "" if upper is None else f"{'less than ' * ('exclusiveMaximum' in entry)}{compact(upper)}"
    if not upper_text:
        return f", {lower_text}" if "exclusiveMinimum" in entry else f", at least {lower_text}"
    if not lower_text:
        return f", at most {upper_text}"
    return f", {lower_text} to {upper_text}"


def _toml(value: Any) -> str:
    """Return a default as TOML; empty for none, and for a table, whose keys have defaults."""
    if value is None or isinstance(value, dict):
        return ""
    return json.dumps(value, ensure_ascii=False)
