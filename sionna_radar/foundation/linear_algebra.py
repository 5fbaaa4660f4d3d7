"""Linear algebra on one thread.

A split among several threads would change the rounding, the last bits of every result. For the small matrices of a
survey, several threads are not faster anyway.
"""

import sys
from collections.abc import Callable
from ctypes import CFUNCTYPE, byref, c_char_p, c_int, c_void_p
from functools import cache, lru_cache, wraps
from typing import ParamSpec, TypeVar

import numpy as np
from jaxtyping import Float
from threadpoolctl import ThreadpoolController

# Rows that a triangular system is solved by at once.
ROWS = 96

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def on_one_thread(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Return a function that runs with one thread of BLAS and OpenMP; the caller's settings are restored afterwards."""

    @wraps(function)
    def limited(*given: Arguments.args, **named: Arguments.kwargs) -> Result:
        with _thread_pools(len(sys.modules)).limit(limits=1):
            return function(*given, **named)

    return limited


@lru_cache(maxsize=1)
def _thread_pools(modules: int) -> ThreadpoolController:
    """Return the thread pools of the libraries loaded so far; to look for them takes 3 ms."""
    return ThreadpoolController()


def solve_lower(root: Float[np.ndarray, "n n"], right: Float[np.ndarray, "n ..."]) -> Float[np.ndarray, "n ..."]:
    """Return root^-1 right for a lower triangular matrix, whose upper triangle must be zero.

    By blocks of rows, nearly all in products of matrices: faster than LAPACK's way, and beside other threads, which
    SciPy's wrapper of that keeps waiting.
    """
    solved = np.empty_like(right)
    for low in range(0, len(root), ROWS):
        rows = slice(low, low + ROWS)
        solved[rows] = np.linalg.inv(root[rows, rows]) @ (right[rows] - root[rows, :low] @ solved[:low])
    return solved


def inverse_and_solution(
    matrix: Float[np.ndarray, "n n"], right: Float[np.ndarray, " n"]
) -> tuple[float, Float[np.ndarray, " n"]]:
    """Overwrite the lower triangle of a positive definite matrix, the only one read, with that of its inverse.

    Returns half the logarithm of the matrix's determinant, and inverse times `right`. Raises LinAlgError if the matrix
    is not positive definite, ValueError if it is no whole array of doubles. SciPy's wrappers of LAPACK keep other
    threads waiting; its functions called directly do not.
    """
    if matrix.dtype != np.float64 or not matrix.flags.c_contiguous or matrix.shape != 2 * right.shape:
        raise ValueError(f"matrix is {matrix.dtype} of shape {matrix.shape}; make it a contiguous square of float64")
    # A lower triangle along rows is the upper one of Fortran's order.
    upper, order, one, failed = b"U", byref(c_int(len(right))), byref(c_int(1)), c_int()
    whole, solved = matrix.ctypes.data, np.array(right, dtype=np.float64)
    _lapack("dpotrf", upper, order, whole, order, byref(failed))
    if failed.value:
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    half = float(np.log(np.diag(matrix)).sum())
    _lapack("dpotrs", upper, order, one, whole, order, solved.ctypes.data, order, byref(failed))
    _lapack("dpotri", upper, order, whole, order, byref(failed))
    return half, solved


def _lapack(name: str, upper: bytes, *addresses: object) -> None:
    _lapack_function(name, len(addresses))(upper, *addresses)


@cache
def _lapack_function(name: str, addresses: int) -> Callable[..., None]:
    from numba.extending import get_cython_function_address

    types = c_char_p, *[c_void_p] * addresses
    return CFUNCTYPE(None, *types)(get_cython_function_address("scipy.linalg.cython_lapack", name))
