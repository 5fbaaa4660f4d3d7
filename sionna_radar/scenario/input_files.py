"""The files that a scenario is flown from, by which a run that goes on knows that nothing has changed."""

from collections.abc import Iterator, Mapping
from glob import escape
from pathlib import Path
from typing import Any

from sionna_radar.foundation.network import is_address
from sionna_radar.scenario.scenario import Scenario
from sionna_radar.scenario.table import Table

# Files that name other files, wherever these are.
NAMES_OTHERS = {".obj", ".gltf", ".xml", ".dae", ".vrt"}


def identity(scenario: Scenario, block_size: int) -> dict[str, Any]:
    """Return what the parts of a survey depend on, as a JSON document."""
    return {
        "scenario": scenario.model_dump(mode="json"),
        "seed": scenario.seed,
        "block size": block_size,
        "input file": input_files(scenario),
    }


def input_files(scenario: Scenario) -> dict[str, list[int]]:
    """Return size in bytes and time of the last change, in nanoseconds, of the files that a scenario names."""
    stamps = {}
    for path in _paths(scenario.model_dump()):
        if path.is_file():
            stat = path.stat()
            stamps[str(path)] = [stat.st_size, stat.st_mtime_ns]
    return stamps


def content_key(tables: Mapping[str, Any]) -> str | None:
    """Return what is built from some tables as one text: their values, and the identity of the files that they name.

    Two equal texts stand for the same content: of each file, and of those beside it whose names begin alike, size,
    place on the disk, and the times of the last changes of content and of record, in nanoseconds. None where that
    cannot be said: a file that names others, an address on the network.
    """
    document = {name: _dumped(value) for name, value in tables.items()}
    if any(is_address(leaf) for leaf in _leaves(document) if isinstance(leaf, str)):
        return None
    stamps = {}
    for path in sorted(set(_paths(document))):
        if path.suffix.lower() in NAMES_OTHERS or not path.is_file():
            return None
        for beside in sorted(path.parent.glob(f"{escape(path.stem)}*")):
            stat = beside.stat()
            stamps[str(beside.resolve())] = (stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns)
    return repr((document, stamps))


def _dumped(value: Any) -> Any:
    """Return a value with its tables, which are told with their classes, as plain ones."""
    if isinstance(value, Table):
        return type(value).__module__, type(value).__qualname__, value.model_dump()
    if isinstance(value, Mapping):
        return {key: _dumped(entry) for key, entry in value.items()}
    return tuple(_dumped(entry) for entry in value) if isinstance(value, list | tuple) else value


def _leaves(value: Any) -> Iterator[Any]:
    """Yield the values within nested tables and lists."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else None
    if inner is None:
        yield value
        return
    for entry in inner:
        yield from _leaves(entry)


def _paths(value: Any) -> Iterator[Path]:
    return (leaf for leaf in _leaves(value) if isinstance(leaf, Path))
