"""A helper process that compiles kernels while the first run on a machine loads its scene and flies.

Numba compiles a function when it is first called and keeps the machine code on disk. It holds Python's lock, so another
thread gains nothing; another process fills the same cache on a second core. It goes through `first_kernels.txt` from
the last function that a run needs to the first, so that the two meet in the middle and hardly compile anything twice.

A line of that file has the maps whose runs need the function (`stepped` those with `dem.method = "stepped"`, `linear`
all others, `all` both), module, function and the types of its arguments; `tests/foundation/test_ahead.py` compares it
with a run. A function that is missing there is compiled when it is called.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from sionna_radar.foundation.threads import cores

LIST = Path(__file__).with_name("first_kernels.txt")


@contextmanager
def compiled_ahead(dem_method: str) -> Iterator[bool]:
    """Compile what a run needs beside it, and yield whether there is anything to compile."""
    if cores() == 1 or not _is_first(dem_method):
        yield False
        return
    command = [sys.executable, "-m", __spec__.name, dem_method]
    helper = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield True
    finally:
        helper.terminate()
        helper.wait()


def kernels(dem_method: str) -> list[tuple[str, str, str, str]]:
    """Return the lines of the list that a run needs, in its order: maps, module, function and types."""
    own = "stepped" if dem_method == "stepped" else "linear"
    lines = (line.split(maxsplit=3) for line in LIST.read_text(encoding="utf-8").splitlines())
    return [(maps, module, name, types) for maps, module, name, types in lines if maps in ("all", own)]


def argument_types(text: str, module: ModuleType) -> tuple[Any, ...]:
    """Return Numba's types for a text such as `i8, Tuple(f8, f8), f4[:,::1]`; named tuples are those of the module."""
    from numba import types

    def of_tuple(kind: type | None, *fields: Any) -> Any:
        return types.BaseTuple.from_types(fields, kind)

    named = {name: kind for name, kind in vars(module).items() if hasattr(kind, "_fields")}
    names = {**vars(types), "Tuple": partial(of_tuple, None), **{n: partial(of_tuple, k) for n, k in named.items()}}
    found: tuple[Any, ...] = eval(f"({text},)", names)
    return found


def _is_first(dem_method: str) -> bool:
    """Return whether no machine code is kept of the first function that only runs with such a map need."""
    module, name = next((module, name) for maps, module, name, _ in kernels(dem_method) if maps != "all")
    folder = Path(getattr(import_module(f"sionna_radar.{module}"), name).stats.cache_path)
    return not any(folder.glob(f"*.{name}-*.nbi"))


def main(dem_method: str) -> None:
    """Compile the kernels of runs with a DEM method, from the last to the first."""
    for _, name, function, text in reversed(kernels(dem_method)):
        module = import_module(f"sionna_radar.{name}")
        getattr(module, function).compile(argument_types(text, module))


if __name__ == "__main__":
    main(sys.argv[1])
