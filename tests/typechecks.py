"""The type checker of the tests: beartype, for the first calls of each function in each test.

Checking every call took a quarter more processor time (26:18 against 20:27 for the suite), most of it in small
functions that are called a million times.
"""

import sys
from collections import Counter
from collections.abc import Callable
from functools import wraps
from inspect import unwrap
from typing import Any

from beartype import beartype

Function = Callable[..., Any]
# Checks of a function in one test: of its parameters before a call, and of its result after it.
MOST_CHECKS = 40
_checks: dict[tuple[object, ...], Function] = {}
_count: Counter[tuple[str, str]] = Counter()
_passed: list[Function] = []


def renew() -> None:
    """Check the first calls of all functions again."""
    _count.clear()
    while _passed:
        del _passed.pop().__no_type_check__  # type: ignore[attr-defined]


def _let_pass(module: str, name: str) -> None:
    """Have jaxtyping leave a function of a module or class alone, which then costs nothing; not one of a function."""
    found: Any = sys.modules[module]
    for part in name.split("."):
        found = vars(found).get(part) if hasattr(found, "__dict__") else None
    for inner in ("fget", "func", "__func__"):
        found = getattr(found, inner, found)
    if callable(found) and not hasattr(unwrap(found), "__no_type_check__"):
        _passed.append(unwrap(found))
        _passed[-1].__no_type_check__ = True  # type: ignore[attr-defined]


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
    name = function.__module__, function.__qualname__
    parameters = code.co_varnames, code.co_argcount, code.co_kwonlyargcount, code.co_flags
    key = (*name, *parameters, defaults, *(function.__kwdefaults__ or ()))
    check = None

    @wraps(function)
    def call(*values: object, **named: object) -> object:
        nonlocal check
        _count[name] += 1
        if _count[name] == MOST_CHECKS:
            _let_pass(*name)
        if _count[name] > MOST_CHECKS:
            return None
        if check is None:
            whole = (*key, repr(function.__annotations__))
            check = _checks.get(whole) or _checks.setdefault(whole, beartype(function))
        return check(*values, **named)

    return call
