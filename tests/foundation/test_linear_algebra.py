"""Triangular systems by blocks, and positive definite matrices, against the plain solutions."""

import sys
import time
from threading import Event, Thread

import numpy as np
import pytest

from sionna_radar.foundation.linear_algebra import ROWS, inverse_and_solution, solve_lower


def _positive(n: int, seed: int = 0) -> np.ndarray:
    half = np.random.default_rng(seed).normal(size=(n, n + 5))
    return half @ half.T


@pytest.mark.parametrize("size", [1, ROWS, 2 * ROWS + 7])
def test_a_triangular_system_is_solved_by_blocks_of_rows(size):
    rng = np.random.default_rng(size)
    root = np.tril(rng.standard_normal((size, size))) / np.sqrt(size) + np.eye(size)
    for right in (rng.standard_normal(size), rng.standard_normal((size, 3))):
        np.testing.assert_allclose(root @ solve_lower(root, right), right, rtol=0, atol=1e-9)


@pytest.mark.parametrize("n", [1, 2, 65, 260])
def test_a_positive_definite_matrix_is_inverted_in_its_place(n):
    matrix, right = _positive(n), np.random.default_rng(1).normal(size=n)
    # What lies above the diagonal is not read.
    inverse = np.tril(matrix) + np.triu(np.full((n, n), np.nan), 1)
    half, solved = inverse_and_solution(inverse, right)
    assert half == pytest.approx(np.linalg.slogdet(matrix)[1] / 2, abs=1e-9)
    np.testing.assert_allclose(matrix @ solved, right, rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.tril(inverse), np.tril(np.linalg.inv(matrix)), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("matrix", "error"),
    [
        (-np.eye(3), np.linalg.LinAlgError),
        (np.eye(3, dtype=np.float32), ValueError),
        (np.eye(6)[::2, ::2], ValueError),
    ],
)
def test_other_matrices_are_refused(matrix, error):
    with pytest.raises(error, match="matrix is"):
        inverse_and_solution(matrix, np.ones(3))


def test_other_threads_go_on_while_a_matrix_is_inverted():
    # Fewer than 500 values: NumPy's own functions of more give Python's lock, too.
    matrix, right, counted, done = _positive(400) + 400 * np.eye(400), np.ones(400), [0], Event()

    def count() -> None:
        while not done.is_set():
            counted[0] += 1
            time.sleep(0)

    other, before = Thread(target=count), sys.getswitchinterval()
    inverse_and_solution(matrix, right)
    # No thread takes Python's lock from another: it has to be given.
    sys.setswitchinterval(600.0)
    try:
        other.start()
        first = counted[0]
        # The lock is given at once; when the other thread gets a core is up to the machine.
        for _ in range(1000):
            inverse_and_solution(matrix, right)
            if counted[0] > first:
                break
        assert counted[0] > first
    finally:
        done.set()
        sys.setswitchinterval(before)
        other.join()
