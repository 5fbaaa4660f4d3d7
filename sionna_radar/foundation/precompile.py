"""Ahead-of-time compilation: on a first run, background processes compile the functions that the survey will call.

Numba compiles the functions of a process one after another, each on its first call. With nothing on disk yet that is
most of a first run, on one core. `start` lets the other cores begin with it while this process still imports what it
needs, loads the ray tracer and traces the scene; what they compile arrives through the cache on disk, and no function
is compiled by two processes at once (`foundation.compiled`). It does without Numba, which takes long to import.

`signatures.txt` names the functions in the order in which a survey needs them, with the types of their arguments in
Numba's notation, in one section per DEM method. `tests/foundation/test_precompile.py` holds it against what surveys
compile.
"""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sionna_radar.foundation.threads import cores

if TYPE_CHECKING:
    from numba import types

PACKAGE, HERE = "sionna_radar", Path(__file__).parents[1]
# More processes cost more memory and start-up time than they save on most machines.
MAX_PROCESSES = 4
# Kept, as they are not waited for: they end by themselves.
_started: list[subprocess.Popen[bytes]] = []


def start(method: str) -> None:
    """Start compiling the functions of a DEM method in the background, unless the last of the list is on disk."""
    *_, (module, name, _) = _lines(method)
    if _is_on_disk(module, name):
        return
    command, nowhere = [sys.executable, "-m", __name__, method], subprocess.DEVNULL
    for _ in range(min(cores() - 1, MAX_PROCESSES)):
        _started.append(subprocess.Popen(command, stdin=nowhere, stdout=nowhere, stderr=nowhere))


def _is_on_disk(module: str, name: str) -> bool:
    """Return True if there is compiled code of a function, for any types, in one of the places where Numba keeps it."""
    *folders, file = module.split(".")
    users = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "numba"  # noqa: PTH111 (raises nothing without a home)
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    places = Path(chosen).glob("*") if chosen else (HERE.joinpath(*folders, "__pycache__"), *users.glob("*"))
    return any(index for place in places for index in place.glob(f"{file}.{name}-*.nbi"))


def signatures(method: str) -> Iterator[tuple[Any, "tuple[types.Type, ...]"]]:
    """Return compiled functions and the types of their arguments, those of all surveys first."""
    for module, name, arguments in _lines(method):
        function = getattr(import_module(f"{PACKAGE}.{module}"), name)
        yield function, _types_of(arguments, function)


def _lines(method: str) -> Iterator[tuple[str, str, str]]:
    """Return the module, the name and the types of the arguments of each function in the list."""
    chosen = False
    for line in (HERE / "foundation" / "signatures.txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            chosen = line in ("[all]", f"[{method}]")
        elif chosen and line:
            module, name, arguments = line.split(" ", 2)
            yield module, name, arguments


def described(argument: "types.Type") -> str:
    """Return the type of an argument as `signatures.txt` names it."""
    from numba import types

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


def _types_of(arguments: str, function: Any) -> "tuple[types.Type, ...]":
    from numba import types

    named = {"Named": lambda of, parts: types.NamedTuple(parts, of)}
    # The text is our own, and its grammar that of Numba's types.
    return tuple(eval(arguments, {**vars(types), "bool": types.boolean, **function.py_func.__globals__, **named}))


def main(arguments: Sequence[str]) -> None:
    """Compile the functions of a method, until all are on disk or the parent process has ended."""
    from sionna_radar.foundation.compiled import SharedCache

    parent = os.getppid()
    for function, argument_types in signatures(arguments[0]):
        # Where nothing can be kept on disk, nobody else would gain.
        if os.getppid() != parent or not isinstance(function._cache, SharedCache):
            return
        if not function._cache.is_claimed():
            function.compile(argument_types)


if __name__ == "__main__":
    main(sys.argv[1:])
