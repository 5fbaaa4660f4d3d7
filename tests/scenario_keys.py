"""All keys of a scenario, those of its parts too."""

from collections.abc import Iterator

from sionna_radar.scenario.table import Table


def keys_of(table: type[Table]) -> list[tuple[str, ...]]:
    """Return the keys of a table, of the tables in it, and of those that it may hold by the name of a part."""
    return list(dict.fromkeys(_keys(table, ())))


def _keys(table: type[Table], prefix: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    for name, field in table.model_fields.items():
        yield (*prefix, name)
        inner = [field.annotation] if isinstance(field.annotation, type) else []
        for chosen in field.metadata:
            inner += chosen.tables() if hasattr(chosen, "tables") else []
        for part in inner:
            if issubclass(part, Table):
                yield from _keys(part, (*prefix, name))
