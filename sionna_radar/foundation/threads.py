"""Multithreaded loops, divided into the same chunks whatever the number of cores."""

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
# Smallest chunk worth a thread, rows, and chunks for each core, which take unequal times.
MIN_ROWS, PER_CORE = 16, 4
# Memory that a chunk works on, so that it stays in a core's cache.
CHUNK_BYTES = 2**20


def chunks(count: int, at_once: int) -> list[tuple[int, int]]:
    """Return the bounds of the chunks of a loop, each of at most `at_once` steps."""
    return [(low, min(low + at_once, count)) for low in range(0, count, at_once)]


def chunks_of_bytes(count: int, each: int) -> list[tuple[int, int]]:
    """Return the bounds of the chunks of a loop whose steps each work on so many bytes: of a core's cache together."""
    return chunks(count, max(CHUNK_BYTES // max(each, 1), 1))


def equal_chunks(count: int, number: int = 4) -> list[tuple[int, int]]:
    """Return the bounds of a number of nearly equal chunks of a loop."""
    return [(count * k // number, count * (k + 1) // number) for k in range(number)]


def in_threads(function: Callable[[int, int], Result], bounds: list[tuple[int, int]]) -> Iterator[Result]:
    """Yield the results of a function for each chunk of a loop, in order, computed by a thread pool.

    The function must release Python's global lock. A loop inside a chunk runs on the chunk's own thread, since all
    threads of the pool may wait for theirs.
    """
    if cores_of_thread() == 1 or len(bounds) == 1:
        return iter([function(low, high) for low, high in bounds])
    return _pool().map(function, *zip(*bounds, strict=True)) if bounds else iter(())


def several_at_once(work: Callable[[int], Result], numbers: Sequence[int], steps: Sequence[int]) -> Iterator[Result]:
    """Yield the results of a function for each number, in order, as many at once as there are cores.

    work: called with a number. It should spend its time where Python's lock is released. One alone has all cores for
        loops of its own.
    numbers, steps: what to do, and how many steps of the current stage each takes at most: counted as they are done if
        there is one number alone, otherwise when each has finished.
    """
    if cores_of_thread() == 1 or len(numbers) < 2:
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
    """Call `work` with the first row and the last, plus one, of each chunk of rows, on all cores.

    `work` must release Python's global lock, and compute each row independently of the others, so that the number of
    chunks changes no result.
    """
    number = min(PER_CORE * cores(), rows // MIN_ROWS)
    if number < 2:
        work(0, rows)
        return
    for _ in in_threads(work, equal_chunks(rows, number)):
        pass


def in_background(function: Callable[[], Result]) -> Callable[[], Result]:
    """Start a function on a background thread; the returned function waits for its result.

    The function must release Python's global lock. Only one runs at a time; inside a chunk of a loop it runs at once.
    """
    if cores_of_thread() == 1:
        result = function()
        return lambda: result
    return _background_thread(os.getpid()).submit(copy_context().run, function).result


def cores_of_thread() -> int:
    """Return the number of cores available to the calling thread: one inside a chunk of a loop."""
    return 1 if threading.current_thread().name.startswith(POOL) else cores()


def cores() -> int:
    """Return the number of cores available to this process, or its thread limit if lower."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(available, thread_limit() or available)


def thread_limit() -> int | None:
    """Return the thread limit set in the environment, None if unset; ScenarioError for no number from 1."""
    text = os.environ.get(THREADS_VARIABLE)
    if text is None:
        return None
    if not text.isdecimal() or int(text) < 1:
        message = f"{text!r} is not a number of threads; give 1 or more, or unset it"
        raise ScenarioError.of(THREADS_VARIABLE, message, "environment")
    return int(text)


@contextmanager
def override_thread_limit(number: int | None) -> Iterator[None]:
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
def _background_thread(process: int) -> ThreadPoolExecutor:
    # Outside the pool, whose threads may all be busy.
    return ThreadPoolExecutor(1, thread_name_prefix=f"sionna-radar-background-{process}")


def _pool() -> ThreadPoolExecutor:
    # A forked process inherits the pool object but not its threads.
    return _pool_of(os.getpid())
