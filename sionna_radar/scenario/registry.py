"""Registries of scans, antennas, sensors, methods and other parts that a scenario names, built-in and custom.

A part is registered under a name with its builder and, if any, its table of parameters. Names come from
three sources: this package, installed packages with the entry-point group `sionna_radar.plugins`, and
registrations of a script before it reads a scenario.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import import_module, metadata
from typing import Any, Literal, TypeVar

from sionna_radar.foundation.errors import PluginError, RadarError
from sionna_radar.foundation.input_file import shown
from sionna_radar.scenario.problems import nearest
from sionna_radar.scenario.table import Table

GROUP = "sionna_radar.plugins"
PACKAGE = "sionna_radar"
NAME = re.compile(r"[^\W_][\w:.+-]{0,63}")

Builder = TypeVar("Builder", bound=Callable[..., Any])
UseOfProfiles = Literal["unused", "optional", "required"]


@dataclass(frozen=True)
class Deferred:
    """A function of this package by its dotted name, whose module is loaded by the first call."""

    name: str

    @cached_property
    def function(self) -> Callable[..., Any]:
        """The function itself."""
        module, _, name = self.name.rpartition(".")
        try:
            return getattr(import_module(f"{PACKAGE}.{module}"), name)
        except ModuleNotFoundError as error:
            if not (error.name or "").startswith(f"{PACKAGE}.{self.name.partition('.')[0]}"):
                raise
            raise RadarError(f"this needs {error.name}, which is not installed; install all of {PACKAGE}") from error

    def __call__(self, *given: Any) -> Any:
        """Call the function."""
        return self.function(*given)


@dataclass(frozen=True, kw_only=True)
class Facts:
    """Facts of a part, for checks of a scenario that must not load the part.

    provides_profiles: of a sensor: whether its observations have range profiles.
    profiles: of a DEM method: how it uses range profiles.
    uses: of a terrain: the `TerrainInputs` on which it depends.
    frame: of a terrain: returns its own local frame on the map, or None, from its parameters.
    """

    provides_profiles: bool = False
    profiles: UseOfProfiles = "unused"
    uses: tuple[str, ...] = ()
    frame: Callable[..., Any] | None = None


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A registered part.

    kind: its kind, in words.
    parameters: the table of its parameters; None for a part without any.
    build: returns the part from its parameters, if any, and the other arguments of its kind.
    origin: its package or script, in words.
    """

    kind: str
    name: str
    parameters: type[Table] | None
    build: Callable[..., Any]
    origin: str
    facts: Facts = Facts()

    def __call__(self, parameters: Table | None, *given: Any) -> Any:
        """Return the part; PluginError where a custom one cannot be built."""
        try:
            return self.build(*given) if self.parameters is None else self.build(parameters, *given)
        except Exception as error:
            if self.origin == PACKAGE or isinstance(error, RadarError):
                raise
            message = f"{self} cannot be built: {type(error).__name__}: {error}; correct the part or its parameters"
            raise PluginError(message) from error

    def __str__(self) -> str:
        return f"{self.kind} {self.name!r} ({self.origin})"

    def check(self, parameters: Any) -> Table | None:
        """Return parameters as the part's own table, defaults filled in; None for a part without parameters.

        Raises pydantic.ValidationError for wrong ones.
        """
        if self.parameters is None:
            return None
        if isinstance(parameters, self.parameters):
            return parameters
        return self.parameters.model_validate({} if parameters is None else parameters)


@dataclass(frozen=True)
class BuiltIn:
    """A part of this package.

    build, table: dotted names of its builder and of the table of its parameters; None for a part without any.
    """

    build: str
    table: str | None = None
    facts: Facts = Facts()

    def entry(self, kind: str, name: str) -> Entry:
        """Return it as registered; its table is loaded, its builder is not."""
        table: Any = None if self.table is None else Deferred(self.table).function
        return Entry(
            kind=kind, name=name, parameters=table, build=Deferred(self.build), origin=PACKAGE, facts=self.facts
        )


class Registry:
    """The parts of one kind.

    kind: kind of the parts, in words.
    ours: the built-in parts by name.
    base: base table of all parameters.
    """

    def __init__(self, kind: str, ours: Mapping[str, BuiltIn], base: type[Table] = Table) -> None:
        self.kind, self.base, self._ours = kind, base, ours
        self._entries: dict[str, Entry] = {}

    def register(
        self, name: str, parameters: type[Any] | None = None, facts: Facts = Facts()
    ) -> Callable[[Builder], Builder]:
        """Return a decorator that registers the builder of a part.

        name: name in scenarios.
        parameters: the table of its parameters, the first argument of the builder.
        facts: what a scenario must know of it.

        Raises PluginError if the name is taken, or the table would let a misspelt key pass.
        """
        if not NAME.fullmatch(name) or name == "none":
            message = f"{self.kind} {shown(name)}: not a name; give letters, digits and any of _ - + : . (not 'none')"
            raise PluginError(message)
        if parameters is None and self.base is not Table:
            raise PluginError(f"{self.kind} {name!r}: it needs parameters; derive them from {self.base.__name__}")
        if parameters is not None and not (isinstance(parameters, type) and issubclass(parameters, self.base)):
            raise PluginError(
                f"{self.kind} {name!r}: its parameters {getattr(parameters, '__name__', parameters)} are not a "
                f"{self.base.__module__}.{self.base.__name__}; derive them from it"
            )

        def add(build: Builder) -> Builder:
            origin = _origin(build)
            entry = Entry(kind=self.kind, name=name, parameters=parameters, build=build, origin=origin, facts=facts)
            self._add(entry)
            return build

        return add

    def _add(self, entry: Entry) -> None:
        existing = self._entries.get(entry.name)
        if existing is None and entry.name in self._ours:
            existing = self.entry(entry.name)
        if existing is not None and _place(existing.build) != _place(entry.build):
            message = f"{self.kind} {entry.name!r} is registered already, by {existing.origin}; choose another name"
            raise PluginError(message)
        self._entries[entry.name] = entry

    def entry(self, name: str) -> Entry:
        """Return a registered part; KeyError for an unknown name."""
        if name not in self._entries and name in self._ours:
            self._entries[name] = self._ours[name].entry(self.kind, name)
        if name not in self._entries:
            load_plugins()
        return self._entries[name]

    def build(self, name: str, protocol: Any, parameters: Table | None, *given: Any) -> Any:
        """Return the part of a name; PluginError where it cannot be built, or lacks members of the protocol."""
        entry = self.entry(name)
        part = entry(parameters, *given)
        require(part, protocol, str(entry))
        return part

    def __contains__(self, name: object) -> bool:
        if name in self._entries or name in self._ours:
            return True
        load_plugins()
        return name in self._entries

    def origins(self) -> dict[str, str]:
        """Return the origins of all parts by name."""
        load_plugins()
        custom = {name: entry.origin for name, entry in self._entries.items() if name not in self._ours}
        return dict.fromkeys(self._ours, PACKAGE) | custom

    def unknown(self, name: object) -> str:
        """Return the message for a name that is not registered."""
        origins = self.origins()
        listing = ", ".join(own_name for own_name, origin in origins.items() if origin == PACKAGE)
        listing += "".join(f", {own_name} (from {origin})" for own_name, origin in origins.items() if origin != PACKAGE)
        broken = "".join(f"; {problem}" for problem in load_plugins())
        return f"{shown(name)} is unknown; give one of {listing}.{nearest(str(name), list(origins))}{broken}"

    def tables(self) -> list[type[Table]]:
        """Return the tables of parameters of all parts, each once."""
        entries = [self.entry(name) for name in self.origins()]
        return list(dict.fromkeys(entry.parameters for entry in entries if entry.parameters is not None))


SECTIONS = """
Parameters
----------
name:
    Its name in scenarios.
parameters:
    Its table of parameters, `{table}`{none}.

Returns
-------
A decorator that registers the builder and returns it unchanged.

Raises
------
PluginError
    The name is taken, or the parameters are not a `{base}`.

Examples
"""


def registers(registry: Registry, table: str) -> Callable[[Builder], Builder]:
    """Return a decorator that adds the common sections to the docstring of a registering function.

    table: position of the parameters in a scenario.
    """
    default_note = "; None if it takes none" if registry.base is Table else ""
    sections = SECTIONS.format(table=table, none=default_note, base=registry.base.__name__)

    def add(function: Builder) -> Builder:
        function.__doc__ = inspect.cleandoc(function.__doc__ or "").replace("\nExamples\n", sections, 1)
        return function

    return add


_loading: list[str] = []
_loaded: dict[str, str] = {}


def load_plugins() -> list[str]:
    """Load installed plug-ins not loaded yet, and return the problems of those that fail."""
    for point in _installed(tuple(sys.path)):
        if point.value in _loaded or point.value in _loading:
            continue
        distribution = point.dist
        origin = f"{distribution.name} {distribution.version}" if distribution else point.value
        _loading.append(origin)
        _loaded[point.value] = ""
        try:
            point.load()
        except (Exception, SystemExit) as error:  # no error may stop a survey that does not use the plug-in
            _loaded[point.value] = (
                f"the plug-in {point.name!r} of {origin} cannot be loaded ({type(error).__name__}: {error}); "
                "mend or uninstall it"
            )
        finally:
            _loading.pop()
    return [problem for problem in _loaded.values() if problem]


@cache
def _installed(search_path: tuple[str, ...]) -> tuple[metadata.EntryPoint, ...]:
    """Return the plug-ins on the search path of modules; listing a hundred packages takes 5 ms."""
    return tuple(metadata.entry_points(group=GROUP))


def _origin(build: Callable[..., Any]) -> str:
    module = getattr(build, "__module__", None) or type(build).__module__
    if module.split(".")[0] == PACKAGE:
        return PACKAGE
    if _loading:
        return _loading[-1]
    file = getattr(sys.modules.get(module), "__file__", None)
    return f"this session ({module})" if module == "__main__" or file is None else f"the module {module}"


def _place(build: Callable[..., Any]) -> tuple[str | None, str | None]:
    """Return the module and name of a builder, so that a rerun notebook cell may register it again."""
    name = getattr(build, "__qualname__", "<nameless>")
    # Anonymous functions cannot be identified by name.
    return getattr(build, "__module__", None), f"{name} {id(build)}" if "<lambda>" in name or name[0] == "<" else name


def require(part: object, protocol: type, what: str) -> None:
    """Check that an object is a part of a kind.

    part, protocol: the part, and its required protocol or class.
    what: the part in words, the beginning of the message.

    Raises PluginError if the part lacks members of the protocol, or is a class instead of an instance.
    """
    if isinstance(part, type):
        raise PluginError(f"{what} is the class {part.__name__}, not an instance; give {part.__name__}(...)")
    if not isinstance(part, protocol):
        members = [name for name in vars(protocol) if not name.startswith("_") or name == "__call__"]
        lacks = ", ".join(name for name in members if not hasattr(part, name))
        message = f"{what} = {type(part).__name__} is not a valid {protocol.__name__}"
        raise PluginError(f"{message}: it lacks {lacks}" if lacks else message)
