"""Linear algebra on one thread: a split among several would change the rounding, the last bits of every result.

For the small matrices of a survey, several threads are not faster anyway.
"""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

Given = ParamSpec("Given")
Result = TypeVar("Result")


def on_one_thread(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Return a function that runs with one thread of BLAS and OpenMP; the caller's settings are restored afterwards."""

    @wraps(function)
    def limited(*given: Given.args, **named: Given.kwargs) -> Result:
        with threadpool_limits(limits=1):
            return function(*given, **named)

    return limited
