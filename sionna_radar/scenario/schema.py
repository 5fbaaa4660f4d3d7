"""The JSON Schema of scenarios, by which editors complete keys, show what they mean and mark misspelt ones."""

from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from sionna_radar.scenario.meaning import meanings, summary, unit_of
from sionna_radar.scenario.scenario import Scenario
from sionna_radar.scenario.table import LARGEST

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
            known = meanings(table)
            for name, about in found.get("properties", {}).items():
                unit = f" ({unit_of(name)})" if unit_of(name) else ""
                if name in known:
                    about["description"] = known[name] + unit
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
