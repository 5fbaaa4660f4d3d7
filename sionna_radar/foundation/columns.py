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

    A subclass is a frozen dataclass whose fields are NumPy arrays of one length along their first axis.
    """

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def rows(self: Table, chosen: Int[np.ndarray, " row"] | Bool[np.ndarray, " entry"] | slice) -> Table:
        """Return some of the rows: by index, mask or slice."""
        return type(self)(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    @classmethod
    def concatenate(cls: type[Table], tables: Sequence[Table]) -> Table:
        """Return all rows of some tables, in order."""
        return cls(**{f.name: np.concatenate([getattr(t, f.name) for t in tables]) for f in fields(cls)})
