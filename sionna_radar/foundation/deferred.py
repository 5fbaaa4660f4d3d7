"""Modules that other libraries import whether they are needed or not, loaded when they are first used.

Sionna RT imports matplotlib, for pictures of scenes and antennas; laspy imports requests, for clouds on the network.
Each takes longer to load than a short survey to simulate. In their place stand names that load them when they are
called or, once the library is imported, looked into. During that import they only have to stand in annotations.

SciPy takes apart the docstrings of 400 functions when it is loaded, to add a note to each: a quarter of its time.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from pkgutil import resolve_name
from types import ModuleType
from typing import Any

# What Sionna RT 2.2 and laspy 2.7 import, and a survey does not need; should they import more of these, it is loaded,
# and nothing else changes.
PLOTTING = ("matplotlib", "matplotlib.colors", "matplotlib.markers", "matplotlib.pyplot")
REQUESTS = ("requests", "requests.adapters", "requests.packages.urllib3.util.retry")
# Of SciPy 1.17; where there is another one, docstrings stay.
DOCSTRING_PARSER = "scipy._lib._docscrape"


class _Placeholder(type):
    """A class that stands for a module, or for what it holds, by its dotted name."""

    importing = False

    def __instancecheck__(cls, value: object) -> bool:
        return isinstance(value, _meant(cls))

    def __getattr__(cls, name: str) -> Any:
        # Python asks modules for their `__spec__` and `__path__`; placeholders have none.
        if name.startswith("_"):
            raise AttributeError(name)
        if _Placeholder.importing:
            return _placeholder(f"{cls.__name__}.{name}")
        return getattr(_meant(cls), name)

    def __call__(cls, *given: Any, **named: Any) -> Any:
        return _meant(cls)(*given, **named)


def _placeholder(name: str) -> _Placeholder:
    return _Placeholder(name, (), {})


def _meant(placeholder: _Placeholder) -> Any:
    """Return the object that a placeholder stands for."""
    return resolve_name(placeholder.__name__)


@contextmanager
def deferred(modules: tuple[str, ...]) -> Iterator[None]:
    """Put placeholders in the place of a module and its parts, the module first; nothing if it is loaded."""
    if modules[0] in sys.modules:
        yield
        return
    sys.modules.update({name: _placeholder(name) for name in modules})  # type: ignore[misc]
    _Placeholder.importing = True
    try:
        yield
    finally:
        _Placeholder.importing = False
        for name in modules:
            del sys.modules[name]


class _DocstringParser(ModuleType):
    """Stands for SciPy's parser of docstrings until it is looked into, and then gives it empty ones of functions."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        sys.modules.pop(self.__name__, None)
        parser = import_module(self.__name__)
        parser.FunctionDoc = partial(parser.FunctionDoc, doc="")  # type: ignore[attr-defined]
        return getattr(parser, name)


def drop_docstrings() -> None:
    """Let SciPy's functions lose their docstrings, in a program that shows none; no effect once SciPy is loaded."""
    if "scipy" not in sys.modules:
        sys.modules[DOCSTRING_PARSER] = _DocstringParser(DOCSTRING_PARSER)
