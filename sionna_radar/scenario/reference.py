"""The reference of all keys of a scenario, and its JSON Schema, made from its tables.

With the schema, editors complete keys, show what they mean and mark misspelt ones.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from sionna_radar.scenario.scenario import Scenario
from sionna_radar.scenario.table import LARGEST, summary, unit_of

# How pydantic calls a bound that it checks after something else, and how the standard does.
BOUNDS = {"ge": "minimum", "le": "maximum", "gt": "exclusiveMinimum", "lt": "exclusiveMaximum"}


class _WithMeanings(GenerateJsonSchema):
    """Adds what the tables say of their keys, and leaves out bounds that no sensible value comes near."""

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """Return the schema of a table with its description and those of its keys."""
        found = super().model_schema(schema)
        table = schema["cls"]
        if issubclass(table, BaseModel):
            found["description"] = summary(table)
            for name, about in found.get("properties", {}).items():
                unit = f" ({unit_of(name)})" if unit_of(name) else ""
                if "description" in about:
                    about["description"] = " ".join(about["description"].split()) + unit
                about.pop("title", None)
        return found

    def float_schema(self, schema: core_schema.FloatSchema) -> JsonSchemaValue:
        """Return the schema of a number without the bounds of any number."""
        found = super().float_schema(schema)
        return {key: value for key, value in found.items() if key not in BOUNDS.values() or abs(value) < LARGEST}


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a scenario, with custom parts that are installed or registered.

    Examples
    --------
    >>> from sionna_radar.scenario import scenario_schema
    >>> "platform" in scenario_schema()["required"]
    True

    """
    found = _of_toml(Scenario.model_json_schema(schema_generator=_WithMeanings))
    return {"$schema": GenerateJsonSchema.schema_dialect, **found, "title": "sionna_radar scenario"}


def _of_toml(schema: Any) -> Any:
    """Return a schema in which nothing may be null, as in TOML, and every bound has the standard's name."""
    if isinstance(schema, list):
        return [_of_toml(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    found = {
        BOUNDS.get(key, key): _of_toml(value) for key, value in schema.items() if (key, value) != ("default", None)
    }
    kinds = [kind for kind in found.get("anyOf", []) if kind != {"type": "null"}]
    if len(kinds) == 1:
        del found["anyOf"]
        return kinds[0] | found
    return found | ({"anyOf": kinds} if kinds else {})


NONE = "-"


@dataclass(frozen=True, kw_only=True)
class Key:
    """A key of a table: what it may hold, its unit, its default as TOML (both empty for none), and its meaning."""

    name: str
    values: str
    unit: str
    default: str
    meaning: str
    required: bool


@dataclass(frozen=True, kw_only=True)
class Section:
    """A table of a scenario, by the place that it has, such as `[radar.antenna]`, and what chooses it there."""

    place: str
    chosen: str
    about: str
    keys: tuple[Key, ...]


def sections() -> list[Section]:
    """Return every table that a scenario may hold, the scenario itself first, each once in each place."""
    schema = scenario_schema()
    found = _walk(schema, "", "", schema["$defs"], ())
    return list({(section.place, section.chosen): section for section in found}.values())


def dotted_keys() -> list[str]:
    """Return every key that `--set` takes, dotted; those of lists and of tables with names of the user's left out."""
    places = [(section.place.strip("[]"), section) for section in sections() if not section.place.startswith("[[")]
    found = [f"{place}.{key.name}".lstrip(".") for place, section in places for key in section.keys]
    return list(dict.fromkeys(key for key in found if "NAME" not in key))


def reference() -> str:
    """Return the reference of all keys as Markdown: a heading for each table, and a table of its keys below it.

    Examples
    --------
    >>> from sionna_radar.scenario import reference
    >>> "## `[platform]`" in reference()
    True

    """
    parts = []
    for section in sections():
        place = f"`{section.place}`" if section.place else "Top level"
        level = "##" if not section.chosen else "###"
        parts.append(f"{level} {place}{' with ' + section.chosen if section.chosen else ''}\n\n{section.about}\n")
        parts.append("| key | value | unit | default | meaning |\n|---|---|---|---|---|")
        parts.append("\n".join(_row(key) for key in section.keys) + "\n")
    return "\n".join(parts)


def _row(key: Key) -> str:
    default = "required" if key.required else f"`{key.default}`" if key.default else NONE
    cells = (f"`{key.name}`", key.values, key.unit or NONE, default, key.meaning)
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"


def _walk(
    schema: Mapping[str, Any], place: str, chosen: str, defs: Mapping[str, Any], above: tuple[str, ...]
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
                values=_values(about, defs),
                unit=unit_of(name),
                default="" if name in required else _toml(about.get("default")),
                meaning=about.get("description", "").removesuffix(f" ({unit_of(name)})"),
                required=name in required,
            )
            for name, about in properties.items()
        ),
    )
    for name, about in properties.items():
        yield from _inside(name, about, place, defs, above)


def _inside(
    name: str, about: Mapping[str, Any], place: str, defs: Mapping[str, Any], above: tuple[str, ...]
) -> Iterator[Section]:
    """Yield the tables that a key may hold."""
    path = place.strip("[]")
    inner = f"{path}.{name}" if path else name
    where = f"[{inner}]"
    if "items" in about:
        about, where = about["items"], f"[[{inner}]]"
    elif "additionalProperties" in about and isinstance(about["additionalProperties"], dict):
        about, where = about["additionalProperties"], f"[{inner}.NAME]"
    tables = [_resolved(kind, defs) for kind in about.get("anyOf", about.get("oneOf", [about]))]
    for table in tables:
        title = table.get("title", "")
        if "properties" in table and title not in above:
            yield from _walk(table, where, _chosen(table) if len(tables) > 1 else "", defs, (*above, title))


def _chosen(table: Mapping[str, Any]) -> str:
    """Return the key and values that select a table among those of its place."""
    for tag in ("kind", "mode", "model"):
        about = table["properties"].get(tag, {})
        names = about.get("enum") or ([about["const"]] if "const" in about else [])
        if names:
            return f"`{tag}` = " + ", ".join(f'`"{name}"`' for name in names)
    return ""


def _resolved(schema: Mapping[str, Any], defs: Mapping[str, Any]) -> Mapping[str, Any]:
    return defs[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema


def _values(about: Mapping[str, Any], defs: Mapping[str, Any]) -> str:
    """Return the allowed values of a key, in words."""
    about = _resolved(about, defs)
    kinds = about.get("anyOf", about.get("oneOf"))
    if kinds:
        return " or ".join(dict.fromkeys(_values(kind, defs) for kind in kinds))
    if "enum" in about:
        return ", ".join(f'`"{name}"`' if isinstance(name, str) else f"`{name}`" for name in about["enum"])
    if "const" in about:
        return f'`"{about["const"]}"`'
    match about.get("type"):
        case "number" | "integer":
            kind = "number" if about["type"] == "number" else "whole number"
            return f"{kind}{_range(about)}"
        case "boolean":
            return "`true` or `false`"
        case "string":
            return "file" if about.get("format") == "path" else "text"
        case "array" if "prefixItems" in about:
            return "[" + ", ".join(_values(entry, defs) for entry in about["prefixItems"]) + "]"
        case "array":
            return f"list of {_values(about.get('items', {}), defs)}"
    if "properties" not in about and isinstance(about.get("additionalProperties"), dict):
        return f"table: names to {_values(about['additionalProperties'], defs)}"
    return "table"


def _range(about: Mapping[str, Any]) -> str:
    low = about.get("minimum", about.get("exclusiveMinimum"))
    high = about.get("maximum", about.get("exclusiveMaximum"))
    if low is None and high is None:
        return ""
    above = f"more than {low:g}" if "exclusiveMinimum" in about else f"{low:g}" if low is not None else ""
    below = f"less than {high:g}" if "exclusiveMaximum" in about else f"{high:g}" if high is not None else ""
    if not below:
        return f", {above}" if "exclusiveMinimum" in about else f", at least {above}"
    if not above:
        return f", at most {below}"
    return f", {above} to {below}"


def _toml(value: Any) -> str:
    """Return a default as TOML; empty for none, and for a table, whose keys have their own."""
    if value is None or isinstance(value, dict):
        return ""
    return json.dumps(value, ensure_ascii=False)
