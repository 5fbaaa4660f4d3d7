"""How a scenario chooses registered parts: by a key inside a table, or by a name with a table beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import AfterValidator, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from sionna_radar.scenario.registry import Registry
from sionna_radar.scenario.table import Table, refuse


@dataclass(frozen=True)
class ChosenBy:
    """Validation of a table of parameters by the registered part that one of its keys names.

    tag: the key; default: the part without it, None where it must be given.
    implied: parts that another key, given without the tag, stands for.
    by_name: a name alone stands for the table of that part without parameters.
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
            meant = next((part for key, part in self.implied.items() if key in value), self.default)
            name = value.get(self.tag, meant)
        else:
            return base.model_validate(value)
        if name is None:
            raise refuse(self.tag, "required, but not given; add it")
        if not isinstance(name, str) or name not in self.registry:
            raise refuse(self.tag, self.registry.unknown(name))
        entry = self.registry.entry(name)
        checked = entry.check({self.tag: name, **value} if isinstance(value, Mapping) else value)
        assert checked is not None  # parts that are chosen by a table have one
        return checked

    def tables(self) -> list[type[Table]]:
        """Return the tables that may stand here."""
        return self.registry.tables()


def name_in(registry: Registry) -> AfterValidator:
    """Return the check of a key that names a registered part."""

    def check(name: str) -> str:
        if name not in registry:
            raise refuse("", registry.unknown(name))
        return name

    return AfterValidator(check)


@dataclass(frozen=True)
class ParametersOf:
    """Validation of the parameters of the part that the key `name` of the same table names."""

    name: str
    registry: Registry

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(
            self._check, serialization=core_schema.simple_ser_schema("any")
        )

    def _check(self, value: Any, info: Any) -> Table | None:
        name = info.data.get(self.name)
        if name is None:  # it is refused already
            return None
        entry = self.registry.entry(name)
        if entry.parameters is None and value is not None:
            raise refuse("", f"{self.registry.kind} {name!r} has no parameters; remove them")
        return entry.check(value)

    def tables(self) -> list[type[Table]]:
        """Return the tables that may stand here."""
        return self.registry.tables()
