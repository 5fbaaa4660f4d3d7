"""Compilation ahead of time: on a first run other processes compile what the survey is going to call.

Numba compiles the functions of a process one after another, each on its first call. With nothing on disk yet that is
most of a first run, on one core. `start` lets the other cores begin with it while this process still loads the ray
tracer and traces the scene; what they compile arrives through the cache on disk, and no function is compiled by two
processes at once (`foundation.compiled`).

`signatures.txt` names the functions in the order in which a survey needs them, with the types of their arguments in
Numba's notation, in one section per DEM method. `tests/foundation/test_precompile.py` holds it against what surveys
compile.
"""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.resources import files
from typing import Any

from numba import types

from sionna_radar.foundation.compiled import SharedCache
from sionna_radar.foundation.threads import cores

PACKAGE = "sionna_radar"
# On most machines memory and the start of the processes cost more than a further one saves.
MAX_PROCESSES = 4
# Kept, as they are not waited for: they end by themselves.
_started: list[subprocess.Popen[bytes]] = []


def start(method: str) -> None:
    """Begin to compile what a survey with a DEM method needs, unless its first function is on disk."""
    function, _ = next(signatures(method))
    if not isinstance(function._cache, SharedCache) or function._cache.holds_any():
        return
    command, nowhere = [sys.executable, "-m", __name__, method], subprocess.DEVNULL
    for _ in range(min(cores() - 1, MAX_PROCESSES)):
        _started.append(subprocess.Popen(command, stdin=nowhere, stdout=nowhere, stderr=nowhere))


def signatures(method: str) -> Iterator[tuple[Any, tuple[types.Type, ...]]]:
    """Return compiled functions and the types of their arguments, those of all surveys first."""
    chosen = False
    for line in (files(PACKAGE) / "foundation" / "signatures.txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            chosen = line in ("[all]", f"[{method}]")
        elif chosen and line:
            module, name, arguments = line.split(" ", 2)
            function = getattr(import_module(f"{PACKAGE}.{module}"), name)
            yield function, _types_of(arguments, function)


def described(argument: types.Type) -> str:
    """Return the type of an argument as `signatures.txt` names it."""
    if isinstance(argument, types.NamedTuple):
        return f"Named({argument.instance_class.__name__}, ({''.join(described(each) + ', ' for each in argument)}))"
    if isinstance(argument, types.BaseTuple):
        return f"Tuple(({''.join(described(each) + ', ' for each in argument)}))"
    if isinstance(argument, types.Array):
        axes = [":"] * argument.ndim
        if argument.layout != "A":
            axes[-1 if argument.layout == "C" else 0] = "::1"
        return f"{argument.dtype}[{', '.join(axes)}]"
    return str(types.unliteral(argument))


def _types_of(arguments: str, function: Any) -> tuple[types.Type, ...]:
    named = {"Named": lambda of, parts: types.NamedTuple(parts, of)}
    # The text is our own, and its grammar that of Numba's types.
    return tuple(eval(arguments, {**vars(types), "bool": types.boolean, **function.py_func.__globals__, **named}))


def main(arguments: Sequence[str]) -> None:
    """Compile what a method needs, until all is on disk or the process that asked for it has ended."""
    asked_by = os.getppid()
    for function, argument_types in signatures(arguments[0]):
        if os.getppid() != asked_by:
            return
        if not function._cache.is_claimed():
            function.compile(argument_types)


if __name__ == "__main__":
    main(sys.argv[1:])
