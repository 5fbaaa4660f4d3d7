"""Linear algebra on one thread: a split among several would change the rounding, the last bits of every result.

For the small matrices of a survey, several threads are not faster anyway.
"""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

# Rows that a triangular system is solved by at once.
ROWS = 96

Given = ParamSpec("Given")
Result = TypeVar("Result")


def on_one_thread(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Return a function that runs with one thread of BLAS and OpenMP; the caller's settings are restored afterwards."""

    @wraps(function)
    def limited(*given: Given.args, **named: Given.kwargs) -> Result:
        with threadpool_limits(limits=1):
            return function(*given, **named)

    return limited


def solve_lower(root: Float[np.ndarray, "n n"], right: Float[np.ndarray, "n ..."]) -> Float[np.ndarray, "n ..."]:
    """Return root^-1 right for a lower triangular matrix; what is above its diagonal must be zero.

    By blocks of rows, nearly all in products of matrices: faster than LAPACK's way, and beside other threads, which
    SciPy's wrapper of that keeps waiting.
    """
    solved = np.empty_like(right)
    for low in range(0, len(root), ROWS):
        rows = slice(low, low + ROWS)
        solved[rows] = np.linalg.inv(root[rows, rows]) @ (right[rows] - root[rows, :low] @ solved[:low])
    return solved
