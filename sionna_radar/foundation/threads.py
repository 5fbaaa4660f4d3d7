"""Machine code on all cores: parts of a loop, divided in the same way whatever the number of cores."""

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from functools import cache
from typing import TypeVar

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.progress import advance, steps_done

Result = TypeVar("Result")

# How many threads this process may use, where that is less than its cores: what workers on one machine are told.
THREADS_VARIABLE = "SIONNA_RADAR_THREADS"

# What the names of the pool's threads begin with.
POOL = "sionna-radar-pool-"
# Fewer rows than this in a part are not worth a thread.
MIN_ROWS = 16


def parts(count: int, at_once: int) -> list[tuple[int, int]]:
    """Return the bounds of the parts of a loop, each of at most so many steps."""
    return [(low, min(low + at_once, count)) for low in range(0, count, at_once)]


def equal_parts(count: int, number: int = 4) -> list[tuple[int, int]]:
    """Return the bounds of a number of nearly equal parts of a loop."""
    return [(count * k // number, count * (k + 1) // number) for k in range(number)]


def in_threads(function: Callable[[int, int], Result], bounds: list[tuple[int, int]]) -> Iterator[Result]:
    """Yield what a function, which must release Python's lock, returns for each part of a loop, in their order.

    Within a part another loop is done by the same thread, as all others may wait for theirs.
    """
    if own_cores() == 1 or len(bounds) == 1:
        return iter([function(low, high) for low, high in bounds])
    return _pool().map(function, *zip(*bounds, strict=True)) if bounds else iter(())


def several_at_once(work: Callable[[int], Result], numbers: Sequence[int], steps: Sequence[int]) -> Iterator[Result]:
    """Yield what a function returns for each number, in their order, as many at once as there are cores.

    Parameters
    ----------
    work:
        Called with a number. It should spend its time where Python's lock is released. One alone has all cores for
        loops of its own.
    numbers, steps:
        What to do, and how many steps of the current stage each takes at most: counted as they are done if there is one
        number alone, otherwise when each has finished.

    """
    if own_cores() == 1 or len(numbers) < 2:
        for number, most in zip(numbers, steps, strict=True):
            before = steps_done()
            result = work(number)
            advance(most - (steps_done() - before))
            yield result
        return
    results = _pool().map(work, numbers)
    for most, result in zip(steps, results, strict=True):
        advance(most)
        yield result


def over_rows(work: Callable[[int, int], None], rows: int) -> None:
    """Call `work`, which must release Python's lock, with the first and the last row, plus one, of parts of all rows.

    What is computed of a row must depend on nothing of the others, so that the number of parts changes no result.
    """
    number = min(cores(), rows // MIN_ROWS)
    if number < 2:
        work(0, rows)
        return
    for _ in in_threads(work, equal_parts(rows, number)):
        pass


def beside(function: Callable[[], Result]) -> Callable[[], Result]:
    """Begin a function, which must release Python's lock, on another core; what is returned waits for its result.

    One at a time: others wait for their turn.
    """
    if cores() == 1:
        found = function()
        return lambda: found
    return _aside(os.getpid()).submit(copy_context().run, function).result


def own_cores() -> int:
    """Return the number of cores that the calling thread may use: within a part of a loop, one."""
    return 1 if threading.current_thread().name.startswith(POOL) else cores()


def cores() -> int:
    """Return the number of cores that this process may use, or less if it is to use so few threads."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(available, given_threads() or available)


def given_threads() -> int | None:
    """Return the number of threads that the environment allows; None if it does not say.

    Raises
    ------
    ScenarioError
        It is not a number, or less than 1.

    """
    text = os.environ.get(THREADS_VARIABLE)
    if text is None:
        return None
    if not text.isdecimal() or int(text) < 1:
        message = f"{text!r} is no number of threads; give 1 or more, or unset it"
        raise ScenarioError([Problem(THREADS_VARIABLE, message)], "environment")
    return int(text)


@contextmanager
def threads_of_all(number: int | None) -> Iterator[None]:
    """Let this process use so many threads instead of what the environment allows one of several; None as it is."""
    if number is None:
        yield
        return
    before = os.environ.get(THREADS_VARIABLE)
    os.environ[THREADS_VARIABLE] = str(number)
    try:
        yield
    finally:
        if before is None:
            del os.environ[THREADS_VARIABLE]
        else:
            os.environ[THREADS_VARIABLE] = before


@cache
def _pool_of(process: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(cores(), thread_name_prefix=f"{POOL}{process}")


@cache
def _aside(process: int) -> ThreadPoolExecutor:
    # Not one of the pool, for whose threads it may have to wait.
    return ThreadPoolExecutor(1, thread_name_prefix=f"sionna-radar-aside-{process}")


def _pool() -> ThreadPoolExecutor:
    # A forked process inherits the pool without its threads.
    return _pool_of(os.getpid())
