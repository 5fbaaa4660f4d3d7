"""Column tables: frozen dataclasses of arrays of equal length, with row selection and lossless serialisation."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, TypeVar

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


def table_of(kind: type, name: str, columns: dict[str, Any], **others: Any) -> Any:
    """Return a table from its columns; 0-d columns become numbers, missing optional ones None."""
    kept = {f.name: f"{name}{OF}{f.name}" for f in fields(kind) if f.name not in others}
    values = {key: columns[column] for key, column in kept.items() if column in columns}
    return kind(**{key: value.item() if value.ndim == 0 else value for key, value in values.items()}, **others)


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
