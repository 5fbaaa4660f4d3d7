"""Caches of the last few values, within a process."""

import logging
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, TypeVar

Value = TypeVar("Value")

logger = logging.getLogger("sionna_radar")


@dataclass(frozen=True, eq=False)
class Same:
    """A key that equals only that of the very same object, which it keeps alive so that its identity stays its own."""

    of: object

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other.of is self.of

    def __hash__(self) -> int:
        return id(self.of)


class KeptValues:
    """The last few values by their keys; what is kept must never be changed by who takes it.

    What was logged while a value was made is logged again whenever it is taken, so that a survey says the same
    whether it made the value or not. A value that cannot be made is not kept.

    most: how many; 0 keeps none.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[Hashable, tuple[Any, list[logging.LogRecord]]] = OrderedDict()
        self._lock = threading.Lock()

    def once(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return the value of a key, made if it is not kept; the oldest ones go before another is made."""
        if self._most == 0:
            return make()
        with self._lock:
            found = self._kept.get(key)
            if found is None:
                while len(self._kept) >= self._most:
                    self._kept.popitem(last=False)
            else:
                self._kept.move_to_end(key)
        if found is None:
            with LogCapture() as heard:
                made = make()
            with self._lock:
                self._kept[key] = (made, heard.records)
            return made
        value: Value = found[0]
        for record in found[1]:
            logger.handle(record)
        return value

    def clear(self) -> None:
        """Keep nothing of what was kept."""
        with self._lock:
            self._kept.clear()

    def __len__(self) -> int:
        return len(self._kept)


class LogCapture(logging.Filter):
    """Record this thread's log messages, and let them pass: a handler would silence the one of last resort."""

    def __init__(self) -> None:
        super().__init__()
        self.records: list[logging.LogRecord] = []
        self._thread = threading.get_ident()

    def __enter__(self) -> "LogCapture":
        logger.addFilter(self)
        return self

    def __exit__(self, *error: object) -> None:
        logger.removeFilter(self)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings among them, each once."""
        return tuple(dict.fromkeys(r.getMessage() for r in self.records if r.levelno >= logging.WARNING))

    def filter(self, record: logging.LogRecord) -> bool:
        """Keep a record, and let it pass."""
        if threading.get_ident() == self._thread:
            self.records.append(record)
        return True
