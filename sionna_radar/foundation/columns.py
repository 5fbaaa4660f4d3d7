"""Tables: frozen dataclasses whose fields are columns of equal length."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Int

# Not `Self`, which the checks of array shapes in the tests cannot resolve.
Table = TypeVar("Table", bound="Columns")


@dataclass(frozen=True, kw_only=True)
class Columns:
    """A table of columns; a row is one entry of each column.

    A subclass is a frozen dataclass whose fields are NumPy arrays of one length along their first axis; a column that
    a table need not have is None in those without.
    """

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def rows(self: Table, chosen: Int[np.ndarray, " row"] | Bool[np.ndarray, " entry"] | slice) -> Table:
        """Return some of the rows: by index, mask or slice."""
        columns = {f.name: getattr(self, f.name) for f in fields(self)}
        return type(self)(**{name: None if column is None else column[chosen] for name, column in columns.items()})

    @classmethod
    def concatenate(cls: type[Table], tables: Sequence[Table]) -> Table:
        """Return all rows of some tables, in order; columns that one of them lacks are left out."""
        columns = {f.name: [getattr(t, f.name) for t in tables] for f in fields(cls)}
        return cls(**{name: _joined(given) for name, given in columns.items()})


def _joined(columns: Sequence[np.ndarray | None]) -> np.ndarray | None:
    given = [column for column in columns if column is not None]
    return np.concatenate(given) if len(given) == len(columns) else None
