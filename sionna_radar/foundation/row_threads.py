"""Work on rows that do not depend on each other, in as many threads as there are processor cores."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

# Fewer rows than this in a part are not worth a thread.
LEAST_ROWS = 16


def over_rows(work: Callable[[int, int], None], rows: int) -> None:
    """Call `work` with the first and the last row, plus one, of parts of all rows.

    The parts run at once in threads, which is of use for compiled code that lets go of Python's lock. What is computed
    of a row must depend on nothing of the others, so that the number of parts changes no result.
    """
    parts = min(cores(), rows // LEAST_ROWS)
    if parts < 2:
        work(0, rows)
        return
    edges = [rows * part // parts for part in range(parts + 1)]
    for done in [_threads().submit(work, first, last) for first, last in pairwise(edges)]:
        done.result()


@cache
def cores() -> int:
    """Return how many processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(cores(), thread_name_prefix="rows")
