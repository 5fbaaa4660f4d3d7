"""Time spent in the stages of a computation, reported like log messages: to the stopwatch of the context."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from time import perf_counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass


class Stopwatch:
    """Adds up the time of stages that may run many times."""

    def __init__(self) -> None:
        self._start = perf_counter()
        self._spent: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Add the time of a block to a stage."""
        start = perf_counter()
        try:
            yield
        finally:
            self._spent[stage] = self._spent.get(stage, 0.0) + perf_counter() - start

    def seconds(self) -> dict[str, float]:
        """Return the seconds of each stage, and under `total` those since the stopwatch was created."""
        return {**self._spent, "total": perf_counter() - self._start}


_stopwatch: ContextVar[Stopwatch | None] = ContextVar("stopwatch", default=None)


@contextmanager
def timing() -> Iterator[Stopwatch]:
    """Yield a stopwatch that adds up what is `timed` in this context."""
    watch = Stopwatch()
    before = _stopwatch.set(watch)
    try:
        yield watch
    finally:
        _stopwatch.reset(before)


@contextmanager
def timed(stage: str) -> Iterator[None]:
    """Add the time of a block to a stage of the context's stopwatch."""
    watch = _stopwatch.get()
    if watch is None:
        yield
        return
    with watch(stage):
        yield
