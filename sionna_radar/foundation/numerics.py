"""Numerical tools: decibels, LAPACK on one thread, log-sum-exp, Halton points, window functions.

Linear algebra runs on one thread: a split among several would change the rounding, the last bits of every result. For
the small matrices of a survey, several threads are not faster anyway.

Halton points fill a square evenly, as `scipy.stats.qmc.Halton` gives them without scrambling, bit for bit.
`scipy.stats` takes as long to import as many a survey to simulate.

Windows over samples are as SciPy computes them, bit for bit. `scipy.signal` brings `scipy.stats` and more with it: for
one window it would take as long as many a survey.
"""

import math
import sys
from collections.abc import Callable
from ctypes import CFUNCTYPE, byref, c_char_p, c_int, c_void_p
from functools import cache, lru_cache, wraps
from typing import ParamSpec, TypeVar

import numpy as np
from jaxtyping import Float, Int
from threadpoolctl import ThreadpoolController

GOLDEN_RATIO = (1 + 5**0.5) / 2


def from_db(value_db: float) -> float:
    """Return the power ratio of a value in dB."""
    return 10.0 ** (value_db / 10.0)


def to_db(ratio: float) -> float:
    """Return a power ratio in dB; a ratio of zero gives minus infinity."""
    return 10.0 * math.log10(ratio) if ratio > 0 else -math.inf


def decibels(ratio: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return power ratios in dB; NaN for ratios that are not positive."""
    return 10.0 * np.log10(np.where(ratio > 0, ratio, np.nan))


# log 3000: one exponential power in 3000 exceeds its mean by this factor; a stronger one is not speckle of one surface.
# Machine code on disk keeps the value that it was compiled with.
MAX_SPECKLE = 8.0


@lru_cache(maxsize=64)
def gauss_legendre(count: int) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    """Return the nodes from -1 to 1, and the weights, of Gauss and Legendre's rule; 200 take tens of milliseconds."""
    return np.polynomial.legendre.leggauss(count)


def log_sum_exp(
    terms: Float[np.ndarray, "..."], axis: int | None = -1, keepdims: bool = False
) -> Float[np.ndarray, "..."]:
    """Return log sum exp over an axis, or over all with None; -inf if all terms are.

    That of `scipy.special` takes a third of the time of a survey in rain.
    """
    peak = terms.max(axis=axis, keepdims=True)
    peak = np.where(np.isfinite(peak), peak, 0.0).astype(terms.dtype)
    with np.errstate(divide="ignore"):
        total = np.log(np.exp(terms - peak).sum(axis=axis, keepdims=True)) + peak
    return total if keepdims else np.asarray(total.squeeze(axis))


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
    """Overwrite the lower triangle of a positive definite matrix with that of its inverse.

    Returns half the logarithm of the matrix's determinant, and inverse times `right`. Reads the lower triangle alone.
    Raises LinAlgError if the matrix is not positive definite, ValueError if it is no whole array of doubles.

    SciPy's wrappers of LAPACK keep other threads waiting; its functions called directly do not.
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


def halton(count: int) -> Float[np.ndarray, "{count} 2"]:
    """Return the first points of the Halton sequence in two dimensions (Halton 1960), the origin first."""
    points = np.zeros((count, 2))
    for axis, base in enumerate((2, 3)):
        rest, fraction = np.arange(count), 1.0
        while rest.any():
            fraction /= base
            points[:, axis] += (rest % base) * fraction
            rest //= base
    return points


# Factors of the cosines of 0, 1, ... turns over the window.
COSINES = {
    "hann": (0.5, 0.5),
    "hamming": (0.54, 1 - 0.54),
    "blackman": (0.42, 0.50, 0.08),
    "blackmanharris": (0.35875, 0.48829, 0.14128, 0.01168),
}


def spread_indices(count: int, total: int) -> Int[np.ndarray, " chosen"]:
    """Return about `count` indices below `total` in rising order, the first and the last among them; or all.

    One is in each of `count` equal parts, at places that follow the golden ratio: equal steps through the pulses of a
    survey may be whole turns of its scan, and meet a few of its angles only.
    """
    if count >= total:
        return np.arange(total)
    part = np.arange(count)
    index = np.floor((part + part * GOLDEN_RATIO % 1.0) * total / count).astype(np.int64)
    index[-1:] = total - 1
    return np.unique(index)


def window(name: str, samples: int) -> Float[np.ndarray, " sample"]:
    """Return a periodic window by its name in `scipy.signal.get_window`."""
    if name not in COSINES:
        from scipy.signal import get_window

        return get_window(name, samples)
    if samples == 1:
        return np.ones(1)
    turn, total = np.linspace(-np.pi, np.pi, samples + 1), np.zeros(samples + 1)
    for number, factor in enumerate(COSINES[name]):
        total += factor * np.cos(number * turn)
    return total[:-1]


def taylor(count: int, nbar: int, side_lobe_ratio_db: float) -> Float[np.ndarray, " element"]:
    """Return the symmetric Taylor window of `scipy.signal.windows.taylor`, not normalised.

    Doerry 2017, "Catalog of Window Taper Functions for Sidelobe Control", Sandia SAND2017-4042, section on Taylor
    windows.
    """
    if count == 1:
        return np.ones(1)
    A = np.arccosh(np.float64(10 ** (side_lobe_ratio_db / 20))) / np.pi
    s2 = nbar**2 / (A**2 + (nbar - 0.5) ** 2)
    order = np.arange(1, nbar, dtype=float)
    square, sign = order * order, np.where(np.arange(nbar - 1) % 2 == 0, 1.0, -1.0)
    factor = np.empty(nbar - 1)
    for m in range(nbar - 1):
        above = sign[m] * np.prod(1 - square[m] / s2 / (A**2 + (order - 0.5) ** 2))
        below = 2 * np.prod(1 - square[m] / square[:m]) * np.prod(1 - square[m] / square[m + 1 :])
        factor[m] = above / below
    place = np.arange(count, dtype=float)
    return 1 + 2 * np.matmul(factor, np.cos(2 * np.pi * order[:, None] * (place - count / 2.0 + 0.5) / count))
