"""Linear algebra on one thread: how it is split among several decides its rounding, the last bits of every result.

For matrices as small as a survey's, several threads are no faster either.
"""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

Given = ParamSpec("Given")
Result = TypeVar("Result")


def on_one_thread(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Return a function that runs with one thread of BLAS and OpenMP; the caller's settings come back after it."""

    @wraps(function)
    def limited(*given: Given.args, **named: Given.kwargs) -> Result:
        with threadpool_limits(limits=1):
            return function(*given, **named)

    return limited
