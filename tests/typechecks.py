"""The type checker of the tests: beartype, for every argument once."""

from collections.abc import Callable
from functools import wraps
from typing import Any

from beartype import beartype

Function = Callable[..., Any]
_checks: dict[tuple[object, ...], Function] = {}


def checked(function: Function) -> Function:
    """Return a function that checks the arguments it is given, or its result.

    jaxtyping hands over two functions that do nothing else: one with a function's parameters, to call before it, and
    one with its result too, to call after it, when the parameters have been checked. What is never called is never
    compiled, and functions within functions, which are decorated whenever they are made, share their check with those
    of the same parameters and annotations.
    """
    result = function.__annotations__.get("return", Any)
    if result is not Any:
        function.__annotations__ = {"return": result}
    code, defaults = function.__code__, len(function.__defaults__ or ())
    parameters = code.co_varnames, code.co_argcount, code.co_kwonlyargcount, code.co_flags
    key = (function.__module__, function.__qualname__, *parameters, defaults, *(function.__kwdefaults__ or ()))
    check = None

    @wraps(function)
    def call(*values: object, **named: object) -> object:
        nonlocal check
        if check is None:
            whole = (*key, repr(function.__annotations__))
            check = _checks.get(whole) or _checks.setdefault(whole, beartype(function))
        return check(*values, **named)

    return call
