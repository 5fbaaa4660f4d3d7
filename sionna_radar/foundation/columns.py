"""Column tables: frozen dataclasses of arrays of equal length, with row selection and lossless serialisation."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from jaxtyping import Bool, Int

# Not `Self`, which the checks of array shapes in the tests cannot resolve.
Table = TypeVar("Table", bound="Columns")


@dataclass(frozen=True, kw_only=True)
class Columns:
    """A table of columns; a row is one entry of each column.

    Subclasses are frozen dataclasses whose fields are NumPy arrays of equal length along their first axis, or tables of
    that length; an optional column may be None, and any other field belongs to the table as a whole.
    """

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def rows(self: Table, chosen: Int[np.ndarray, " row"] | Bool[np.ndarray, " entry"] | slice) -> Table:
        """Return some of the rows: by index, mask or slice."""
        return type(self)(**{f.name: _chosen(getattr(self, f.name), chosen) for f in fields(self)})

    @classmethod
    def concatenate(cls: type[Table], tables: Sequence[Table]) -> Table:
        """Concatenate tables; columns missing from any of them are left out."""
        columns = {f.name: [getattr(t, f.name) for t in tables] for f in fields(cls)}
        return cls(**{name: _joined(pieces) for name, pieces in columns.items()})


def _chosen(column: Any, chosen: Any) -> Any:
    if isinstance(column, Columns):
        return column.rows(chosen)
    return column[chosen] if isinstance(column, np.ndarray) else column


def _joined(columns: Sequence[Any]) -> Any:
    if any(column is None for column in columns):
        return None
    first = columns[0]
    return first.concatenate(columns) if isinstance(first, Columns) else np.concatenate(columns)


# Separator of table and column names.
OF = "."


def packed(**values: Any) -> bytes:
    """Serialise named tables (which may be nested), arrays and numbers."""
    content = io.BytesIO()
    np.savez(
        content, **{key: column for name, value in values.items() for key, column in _columns(name, value).items()}
    )
    return content.getvalue()


def columns_of(content: bytes) -> dict[str, Any]:
    """Return the arrays in serialised bytes by name; columns of a table as `table.column`."""
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def table_of(kind: Any, name: str, columns: dict[str, Any], **others: Any) -> Any:
    """Return a table, and those inside it, from columns; 0-d ones become numbers, optional ones may be missing."""
    values = dict(others)
    for key, inside in _inner_kinds(kind).items():
        column = f"{name}{OF}{key}"
        if key not in others and is_dataclass(inside):
            present = any(other.startswith(f"{column}{OF}") for other in columns)
            values[key] = table_of(inside, column, columns) if present else None
        elif key not in others and column in columns:
            numbers = columns[column]
            values[key] = tuple(numbers.tolist()) if inside else numbers.item() if numbers.ndim == 0 else numbers
    return kind(**values)


@cache
def _inner_kinds(kind: Any) -> dict[str, Any]:
    """Return the kind of each field of a table: another table, a tuple of numbers, or None for a column or number."""
    hints = {f.name: get_type_hints(kind)[f.name] for f in fields(kind)}
    kinds = {
        name: [k for k in (hint, *get_args(hint)) if is_dataclass(k) or get_origin(k) is tuple]
        for name, hint in hints.items()
    }
    return {name: found[0] if found else None for name, found in kinds.items()}


def _columns(name: str, value: Any) -> dict[str, Any]:
    """Flatten nested tables to arrays and numbers by name; None contributes nothing."""
    if value is None:
        return {}
    if not is_dataclass(value):
        return {name: value}
    flat: dict[str, Any] = {}
    for field in fields(value):
        flat |= _columns(f"{name}{OF}{field.name}" if name else field.name, getattr(value, field.name))
    return flat
