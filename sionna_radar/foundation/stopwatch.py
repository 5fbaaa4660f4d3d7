"""Time spent in the stages of a computation, reported like log messages: to the stopwatch of the context."""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from time import perf_counter


class Stopwatch:
    """Adds up the time of stages that may run many times."""

    def __init__(self) -> None:
        self._start = perf_counter()
        self.spent_s: dict[str, float] = defaultdict(float)

    def seconds(self) -> dict[str, float]:
        """Return the seconds of each stage, and under `total` those since the stopwatch was created."""
        return {**self.spent_s, "total": perf_counter() - self._start}


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
    start = perf_counter()
    try:
        yield
    finally:
        if (watch := _stopwatch.get()) is not None:
            watch.spent_s[stage] += perf_counter() - start
