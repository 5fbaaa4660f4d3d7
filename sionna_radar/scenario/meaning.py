"""What the tables of a scenario say of their keys.

The meaning of a key is its entry in the docstring of its table, `name: ...` or `name, other: ...`, or the description
of its field, which a custom table may have instead. Its unit is the end of its name.
"""

import inspect
import re
from collections.abc import Iterator

from pydantic import BaseModel

from sionna_radar.scenario.table import Table

ENTRY = re.compile(r"^(?P<names>[a-z_0-9]+(?:(?:, | or | and )[a-z_0-9]+)*): (?P<text>.+)$")
RULE = re.compile(r"^-{3,}$")
# By the end of a key's name, the longest first.
UNITS = {
    "_mm_per_h": "mm/h",
    "_g_per_m3": "g/m³",
    "_g_cm3": "g/cm³",
    "_per_m2": "1/m²",
    "_wavelengths": "wavelengths",
    "_percent": "%",
    "_mps2": "m/s²",
    "_mps": "m/s",
    "_mrad": "mrad",
    "_dbsm": "dB m²",
    "_dbm": "dBm",
    "_rpm": "1/min",
    "_per_s": "1/s",
    "_deg": "deg",
    "_hpa": "hPa",
    "_db": "dB",
    "_hz": "Hz",
    "_nm": "nm",
    "_ns": "ns",
    "_mm": "mm",
    "_k": "K",
    "_c": "°C",
    "_m": "m",
    "_s": "s",
    "_w": "W",
}


def unit_of(name: str) -> str:
    """Return the unit that the end of a key's name stands for; empty for none."""
    return next((unit for end, unit in UNITS.items() if name.endswith(end)), "")


def meanings(table: type[BaseModel]) -> dict[str, str]:
    """Return the meaning of each key of a table that has one, those of its bases included."""
    found: dict[str, str] = {}
    for base in reversed(table.__mro__):
        if issubclass(base, Table):
            for names, text in _entries(inspect.cleandoc(base.__doc__ or "")):
                found |= dict.fromkeys((name for name in names if name in table.model_fields), text)
    return found | {name: field.description for name, field in table.model_fields.items() if field.description}


def summary(table: type[BaseModel]) -> str:
    """Return what a table says of itself: its docstring without the entries of its keys, and without examples."""
    lines = inspect.cleandoc(table.__doc__ or "").splitlines()
    for number, line in enumerate(lines):
        if RULE.match(line):  # the heading of a section stands above its rule
            return "\n".join(lines[: number - 1]).strip()
        if ENTRY.match(line):
            return "\n".join(lines[:number]).strip()
    return "\n".join(lines).strip()


def _entries(text: str) -> Iterator[tuple[list[str], str]]:
    names: list[str] = []
    words: list[str] = []
    for line in [*text.splitlines(), ""]:
        entry = ENTRY.match(line)
        if entry or not line.strip():
            if names:
                yield names, " ".join(words)
            names, words = [], []
        if entry:
            names, words = re.split(r", | or | and ", entry["names"]), [entry["text"]]
        elif names:
            words.append(line.strip())
