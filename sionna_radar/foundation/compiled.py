"""Compilation of loops over pulses, rays and range cells by Numba, with a cache on disk; sine and cosine of turns.

Numba and not Dr.Jit: the loops are short, irregular and in double precision, a few hundred steps per pulse that differ
from one pulse to the next, which whole-array code would pad; there is no compilation per size of an array, and the
machine code is kept on disk between runs.

Without `fastmath`: sums keep their order, so that results do not depend on the machine's vector length or on how many
pulses are handled at once. Numba is loaded with the first function that is called.

`turned` computes sine and cosine of an angle in turns: its part within an eighth of a turn is exact, and the
polynomials below give both functions of it to the last bit or two. An angle in radians has been rounded when it was
multiplied by 2 pi; and the functions of the system's library keep the compiler from handling several angles at once,
which makes these twenty times as fast.
"""

import math
from collections.abc import Callable
from functools import update_wrapper
from threading import Lock
from typing import Any, TypeVar, cast, no_type_check

import numpy as np

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile a function of numbers and arrays, and those it calls, on its first call.

    Decorate it with `no_type_check` too: run-time type checks in Python would prevent compilation.

    Compilation slows the first run on a machine. Every combination of argument types is compiled separately,
    including literal integers (`f(x, 0)` beside `f(x, n)`) and array layouts (a column slice beside a whole array);
    callers convert. Assigning an array to a slice compiles the text of an error message, about a second; a loop does
    not.
    """
    return cast(Function, CompiledFunction(function))


# Held while a function's machine code is loaded.
LOADING = Lock()


class CompiledFunction:
    """A compiled function, which loads Numba and its machine code when it is first called."""

    def __init__(self, function: Callable[..., object]) -> None:
        self.py_func = function
        self._machine_code: Any = None
        update_wrapper(self, function)

    def __call__(self, *given: Any) -> Any:
        """Call the machine code."""
        return (self._machine_code or self.machine_code)(*given)

    @property
    def machine_code(self) -> Any:
        """Numba's dispatcher; one, whichever threads ask for it at once."""
        from sionna_radar.foundation.machine_code import dispatcher

        with LOADING:
            self._machine_code = self._machine_code or dispatcher(self.py_func)
        return self._machine_code

    @property
    def _numba_type_(self) -> Any:
        """What Numba takes this for in a compiled function that calls it."""
        return self.machine_code._numba_type_


# Taylor series in the square of turns: at an eighth of one the next terms are less than 1e-18.
TERMS = 9
COSINE = tuple((-1) ** k * math.tau ** (2 * k) / math.factorial(2 * k) for k in range(TERMS))
SINE = tuple((-1) ** k * math.tau ** (2 * k + 1) / math.factorial(2 * k + 1) for k in range(TERMS))


@compiled
@no_type_check
def turned(turns):
    """Return the cosine and the sine of an angle in turns, within 2^-52 of both."""
    quarters = np.floor(4.0 * turns + 0.5)
    rest = turns - 0.25 * quarters
    square = rest * rest
    cosine, sine = COSINE[TERMS - 1], SINE[TERMS - 1]
    for k in range(TERMS - 2, -1, -1):
        cosine = cosine * square + COSINE[k]
        sine = sine * square + SINE[k]
    sine *= rest
    quarter = int(quarters) & 3
    x, y = (sine, cosine) if quarter & 1 else (cosine, sine)
    return -x if quarter == 1 or quarter == 2 else x, -y if quarter >= 2 else y
