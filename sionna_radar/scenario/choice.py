"""Validation of keys that select a registered part: by a tag in its own table, or by a name beside its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from sionna_radar.scenario.registry import Registry
from sionna_radar.scenario.table import Table, refuse


@dataclass(frozen=True)
class ChosenBy:
    """Validation of a table of parameters by the registered part that one of its keys names.

    tag: the key; default: the part if absent, None to require it.
    implied: part, by key that implies it without the tag.
    by_name: whether the part's name may replace its table, with default parameters.
    """

    tag: str
    registry: Registry
    default: str | None = None
    implied: Mapping[str, str] = field(default_factory=dict)
    by_name: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(
            self._check, serialization=core_schema.simple_ser_schema("any")
        )

    def _check(self, value: Any) -> Table:
        base = self.registry.base
        if self.by_name and isinstance(value, str):
            value = {self.tag: value}
        if isinstance(value, base):
            name = getattr(value, self.tag)
        elif isinstance(value, Mapping):
            default = next((implied_part for key, implied_part in self.implied.items() if key in value), self.default)
            name = value.get(self.tag, default)
        else:
            return base.model_validate(value)
        if name is None:
            raise refuse(self.tag, f"missing; give one of {', '.join(self.registry.origins())}")
        if not isinstance(name, str) or name not in self.registry:
            raise refuse(self.tag, self.registry.unknown(name))
        entry = self.registry.entry(name)
        checked = entry.check({self.tag: name, **value} if isinstance(value, Mapping) else value)
        assert checked is not None  # parts chosen by a tag have a table
        return checked

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schemas = [handler(table.__pydantic_core_schema__) for table in self.tables()]
        for table, schema in zip(self.tables(), map(handler.resolve_ref_schema, schemas), strict=True):
            self._describe_tag(table, schema)
        return {"anyOf": [*schemas, *([{"enum": list(self.registry.origins())}] if self.by_name else [])]}

    def _describe_tag(self, table: type[Table], schema: JsonSchemaValue) -> None:
        """Add a table's names to its schema; required unless one is the default or implied."""
        names = [name for name in self.registry.origins() if self.registry.entry(name).parameters is table]
        schema["properties"][self.tag] = {"enum": names, "description": f"Kind of {self.registry.kind}."}
        if self.default not in names and not set(self.implied.values()) & set(names):
            schema["required"] = [self.tag, *(key for key in schema.get("required", []) if key != self.tag)]

    def tables(self) -> list[type[Table]]:
        """Return the table types accepted here."""
        return self.registry.tables()


@dataclass(frozen=True)
class NameIn:
    """Validation of a key that names a registered part, or is one of `also`."""

    registry: Registry
    also: tuple[str, ...] = ()

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        # Any text, since a script may register more.
        return {"anyOf": [{"enum": [*self.also, *self.registry.origins()]}, {"type": "string"}]}

    def _check(self, name: str) -> str:
        if name not in self.registry and name not in self.also:
            raise refuse("", self.registry.unknown(name))
        return name


@dataclass(frozen=True)
class ParametersOf:
    """Validation of a part's parameters; `name` is the sibling key that names the part."""

    name: str
    registry: Registry

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(
            self._check, serialization=core_schema.simple_ser_schema("any")
        )

    def _check(self, value: Any, info: Any) -> Table | None:
        name = info.data.get(self.name)
        if name is None or (value is None and name not in self.registry):  # name rejected, or in `also`
            return None
        if name not in self.registry:
            raise refuse("", f"{name!r} has no parameters; remove them, or name the {self.registry.kind}")
        entry = self.registry.entry(name)
        if entry.parameters is None and value is not None:
            raise refuse("", f"{self.registry.kind} {name!r} has no parameters; remove them")
        return entry.check(value)

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schemas = [handler(table.__pydantic_core_schema__) for table in self.tables()]
        for table, schema in zip(self.tables(), map(handler.resolve_ref_schema, schemas), strict=True):
            names = [name for name in self.registry.origins() if self.registry.entry(name).parameters is table]
            schema["$comment"] = f"`{self.name}` = " + ", ".join(f'`"{name}"`' for name in names)
        return {"anyOf": schemas} if schemas else {"type": "object"}

    def tables(self) -> list[type[Table]]:
        """Return the table types accepted here."""
        return self.registry.tables()
