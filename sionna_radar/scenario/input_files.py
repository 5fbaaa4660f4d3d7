"""The files that a scenario is flown from, by which a run that goes on knows that nothing has changed."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sionna_radar.scenario.scenario import Scenario


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


def _paths(value: Any) -> Iterator[Path]:
    if isinstance(value, Path):
        yield value
    elif isinstance(value, dict):
        for entry in value.values():
            yield from _paths(entry)
    elif isinstance(value, list | tuple):
        for entry in value:
            yield from _paths(entry)
