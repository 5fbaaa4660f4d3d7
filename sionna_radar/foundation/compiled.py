"""Loops over pulses, rays and range cells as machine code, by Numba.

Numba and not Dr.Jit: the loops are short, irregular and in double precision, a few hundred steps per pulse that differ
from one pulse to the next, which whole-array code would pad; there is no compilation per size of an array, and the
machine code is kept on disk between runs.

Without `fastmath`: sums keep their order, so that results do not depend on the machine's vector length or on how many
pulses are handled at once. Modules with compiled functions are imported when a function of theirs is first needed:
importing Numba takes half a second.
"""

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile a function of numbers and arrays when it is first called; others that it calls are compiled too.

    It carries `no_type_check` as well, since Numba knows the types: checks in Python would keep it from compiling.
    """
    return cast(Function, njit(cache=True, nogil=True, error_model="numpy")(function))
