"""Cache of terrain, scene, materials and antenna that successive surveys share, and log capture."""

import logging
import threading
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

Value = TypeVar("Value")

logger = logging.getLogger("sionna_radar")


class BuildCache:
    """Cache of terrain, scene, materials and antenna of the latest survey; the next one reuses those that are equal.

    No survey changes a value that it reuses. Messages that were logged while it was built are logged again for each
    such survey, so that its warnings do not depend on earlier surveys.

    Examples
    --------
    >>> cache = BuildCache()
    >>> scenario = load_scenario("hills", {"platform.length_m": 10.0})
    >>> first, second = (prepare(scenario.replace({"seed": seed}), cache=cache) for seed in (1, 2))
    >>> first.world.caster is second.world.caster
    True
    """

    def __init__(self) -> None:
        self._latest: dict[str, tuple[Hashable, Any, list[logging.LogRecord]]] = {}

    def once(self, name: str, key: Hashable, build: Callable[[], Value]) -> Value:
        """Return the latest value of this name if its key is equal, else a new one; with key None always a new one."""
        if key is None:
            return build()
        known, value, records = self._latest.get(name, (None, None, []))
        if known == key:
            for record in records:
                logger.handle(record)
        else:
            self._latest.pop(name, None)
            with LogCapture() as said:
                value = build()
            self._latest[name] = key, value, said.records
        return value


class LogCapture(logging.Filter):
    """Record this thread's log messages without suppressing them; a handler would disable `logging.lastResort`."""

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
        """Distinct messages of level WARNING or above."""
        return tuple(dict.fromkeys(r.getMessage() for r in self.records if r.levelno >= logging.WARNING))

    def filter(self, record: logging.LogRecord) -> bool:
        """Record a message of this thread; suppress none."""
        if threading.get_ident() == self._thread:
            self.records.append(record)
        return True
