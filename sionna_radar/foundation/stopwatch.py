"""Time spent in named stages."""

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter


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
