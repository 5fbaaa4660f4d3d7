"""Tables as bytes, and back again, bit for bit: how finished parts are kept, and what workers return."""

import io
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

# Between the name of a table and that of its column.
OF = "."


def packed(**values: Any) -> bytes:
    """Return the bytes of some tables, which may be nested, arrays and numbers by their names."""
    content = io.BytesIO()
    np.savez(
        content, **{key: column for name, value in values.items() for key, column in _columns(name, value).items()}
    )
    return content.getvalue()


def columns_of(content: bytes) -> dict[str, Any]:
    """Return the arrays of some bytes, those of a table by its name, a dot and theirs."""
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def table_of(kind: type, name: str, columns: dict[str, Any], **others: Any) -> Any:
    """Return a table from its columns; a column without axes is a number, and one that may be left out None."""
    kept = {f.name: f"{name}{OF}{f.name}" for f in fields(kind) if f.name not in others}
    own = {key: columns[column] for key, column in kept.items() if column in columns}
    return kind(**{key: value.item() if value.ndim == 0 else value for key, value in own.items()}, **others)


def _columns(name: str, value: Any) -> dict[str, Any]:
    """Return the arrays and numbers of nested tables by their names; None has none."""
    if value is None:
        return {}
    if not is_dataclass(value):
        return {name: value}
    found: dict[str, Any] = {}
    for field in fields(value):
        found |= _columns(f"{name}{OF}{field.name}" if name else field.name, getattr(value, field.name))
    return found
