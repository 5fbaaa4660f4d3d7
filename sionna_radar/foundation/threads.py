"""Loops on all cores, divided into the same parts whatever the number of cores."""

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from functools import cache
from typing import TypeVar

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.progress import advance, steps_done

Result = TypeVar("Result")

# Thread limit of a process, set for workers that share a machine.
THREADS_VARIABLE = "SIONNA_RADAR_THREADS"

# Name prefix of the pool's threads.
POOL = "sionna-radar-pool-"
# Smallest part worth a thread, rows.
MIN_ROWS = 16


def parts(count: int, at_once: int) -> list[tuple[int, int]]:
    """Return the bounds of the parts of a loop, each of at most `at_once` steps."""
    return [(low, min(low + at_once, count)) for low in range(0, count, at_once)]


def equal_parts(count: int, number: int = 4) -> list[tuple[int, int]]:
    """Return the bounds of a number of nearly equal parts of a loop."""
    return [(count * k // number, count * (k + 1) // number) for k in range(number)]


def in_threads(function: Callable[[int, int], Result], bounds: list[tuple[int, int]]) -> Iterator[Result]:
    """Yield the results of a function for each part of a loop, in their order; it must release Python's lock.

    Within a part another loop is done by the same thread, as all others may wait for theirs.
    """
    if own_cores() == 1 or len(bounds) == 1:
        return iter([function(low, high) for low, high in bounds])
    return _pool().map(function, *zip(*bounds, strict=True)) if bounds else iter(())


def several_at_once(work: Callable[[int], Result], numbers: Sequence[int], steps: Sequence[int]) -> Iterator[Result]:
    """Yield the results of a function for each number, in their order, as many at once as there are cores.

    work: called with a number. It should spend its time where Python's lock is released. One alone has all cores for
        loops of its own.
    numbers, steps: what to do, and how many steps of the current stage each takes at most: counted as they are done if
        there is one number alone, otherwise when each has finished.
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

    One at a time: others wait for their turn. Within a part of a loop it is done at once.
    """
    if own_cores() == 1:
        found = function()
        return lambda: found
    return _aside(os.getpid()).submit(copy_context().run, function).result


def own_cores() -> int:
    """Return the number of cores available to the calling thread: one inside a part of a loop."""
    return 1 if threading.current_thread().name.startswith(POOL) else cores()


def cores() -> int:
    """Return the number of cores available to this process, or its thread limit if lower."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(available, given_threads() or available)


def given_threads() -> int | None:
    """Return the thread limit set in the environment; None if unset.

    Raises ScenarioError if it is not a number, or less than 1.
    """
    text = os.environ.get(THREADS_VARIABLE)
    if text is None:
        return None
    if not text.isdecimal() or int(text) < 1:
        message = f"{text!r} is not a number of threads; give 1 or more, or unset it"
        raise ScenarioError.of(THREADS_VARIABLE, message, "environment")
    return int(text)


@contextmanager
def threads_of_all(number: int | None) -> Iterator[None]:
    """Temporarily override the thread limit of this process (None: unchanged)."""
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
    # Outside the pool, whose threads may all be busy.
    return ThreadPoolExecutor(1, thread_name_prefix=f"sionna-radar-aside-{process}")


def _pool() -> ThreadPoolExecutor:
    # A forked process inherits the pool object but not its threads.
    return _pool_of(os.getpid())
