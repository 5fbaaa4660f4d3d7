"""Shapes of arguments and results are checked in runs with `--jaxtyping-packages=sionna_radar,typechecks.checked`."""

import numpy as np
import pytest
from jaxtyping import Float, TypeCheckError, jaxtyped

from typechecks import MOST_CHECKS, checked, renew


@pytest.fixture
def package_is_checked(request):
    """Skip a run in which the package is not checked."""
    if not request.config.getoption("--jaxtyping-packages"):
        pytest.skip("run with --jaxtyping-packages=sionna_radar,typechecks.checked")


def doubled(length: int):
    """Return a function, made anew, of a vector to one of another length."""

    @jaxtyped(typechecker=checked)
    def inner(values: Float[np.ndarray, " n"], *, scale: float = 2.0) -> Float[np.ndarray, " n"]:
        return np.full(length, scale)

    return inner


def test_a_wrong_argument_and_a_wrong_result_are_told_apart():
    for _ in range(2):
        assert doubled(3)(np.zeros(3)).tolist() == [2.0] * 3
        assert doubled(3)(np.zeros(3), scale=1.0).tolist() == [1.0] * 3
        for wrong in (np.zeros(3, dtype=int), np.zeros((3, 1)), [0.0] * 3):
            with pytest.raises(TypeCheckError, match="parameters of"):
                doubled(3)(wrong)
        with pytest.raises(TypeCheckError, match="parameters of"):
            doubled(3)(np.zeros(3), scale="1")
        with pytest.raises(TypeCheckError, match="return value"):
            doubled(4)(np.zeros(3))


@pytest.mark.usefixtures("package_is_checked")
def test_the_package_is_checked():
    from sionna_radar.foundation.decibels import decibels

    with pytest.raises(TypeCheckError, match="parameters of"):
        decibels(np.zeros((2, 2)))


@pytest.mark.usefixtures("package_is_checked")
def test_the_first_calls_of_each_test_are_checked():
    from sionna_radar.foundation.decibels import decibels

    for _ in range(MOST_CHECKS):
        decibels(np.ones(2))
    decibels(np.ones((2, 2)))
    renew()
    with pytest.raises(TypeCheckError, match="parameters of"):
        decibels(np.ones((2, 2)))
