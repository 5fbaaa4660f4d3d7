"""All keys of a scenario, those of its parts too; and tables with some of them set."""

from collections.abc import Iterator, Mapping
from copy import deepcopy
from typing import Any

from sionna_radar.scenario.overrides import apply_overrides
from sionna_radar.scenario.table import Table


def keys_of(table: type[Table]) -> list[tuple[str, ...]]:
    """Return the keys of a table, of the tables in it, and of those that it may hold by the name of a part."""
    return list(dict.fromkeys(_keys(table, ())))


def with_keys(tables: Mapping[str, Any], keys: Mapping[str, Any]) -> dict[str, Any]:
    """Return tables with values by dotted key, a dot also written as __; None removes one."""
    data = deepcopy(dict(tables))
    apply_overrides(data, {key.replace("__", "."): value for key, value in keys.items()})
    return data


def _keys(table: type[Table], prefix: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    for name, field in table.model_fields.items():
        yield (*prefix, name)
        inner = [field.annotation] if isinstance(field.annotation, type) else []
        for chosen in field.metadata:
            inner += chosen.tables() if hasattr(chosen, "tables") else []
        for part in inner:
            if issubclass(part, Table):
                yield from _keys(part, (*prefix, name))
