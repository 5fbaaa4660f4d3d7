"""Modules that other libraries import whether they are needed or not, loaded when they are first used.

Sionna RT imports matplotlib, for pictures of scenes and antennas; laspy imports requests, for clouds on the network.
Each takes longer to load than a short survey to simulate. In their place stand names that load them when they are
called or, once the library is imported, looked into. During that import they only have to stand in annotations.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pkgutil import resolve_name
from typing import Any

# What Sionna RT 2.2 and laspy 2.7 import, and a survey does not need; should they import more of these, it is loaded,
# and nothing else changes.
PLOTTING = ("matplotlib", "matplotlib.colors", "matplotlib.markers", "matplotlib.pyplot")
REQUESTS = ("requests", "requests.adapters", "requests.packages.urllib3.util.retry")


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
