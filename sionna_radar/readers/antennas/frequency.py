"""The frequency that a pattern file states: an antenna's beam is that of its frequency.

MSI Planet files have a line FREQUENCY, in MHz unless it names another unit, of one frequency or a band ("1710-1880").
Reports of HFSS name it in the header (Freq='77GHz'), its fields in a line Frequency, Hz; far-field sources of CST
below "... Power, Frequency", Hz, after three powers. Tables of CST and our own CSV state none.
"""

import re
from pathlib import Path

UNITS_HZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9}
# Of a file, in which its frequency stands before the pattern.
HEAD_BYTES = 65_536
NUMBER = r"(\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?)"
UNIT = r"\s*([kMG]?Hz)?"
PLANET = re.compile(rf"^\s*FREQUENCY[\s:=]+{NUMBER}{UNIT}(?:\s*(?:-|to|\s)\s*{NUMBER}{UNIT})?\s*$", re.I | re.M)
REPORT = re.compile(rf"freq\s*=\s*'?\s*{NUMBER}{UNIT}", re.I)
FIELD = re.compile(rf"^\s*Frequency\s+{NUMBER}\s*$", re.I | re.M)
SOURCE = re.compile(rf"^//[^\n]*Power\s*,\s*Frequency[^\n]*\n(?:\s*[-+\d.eE]+\s+){{3}}{NUMBER}", re.I | re.M)


def stated_frequency_hz(text: str) -> tuple[float, float] | None:
    """Return the lowest and highest frequency that the head of a pattern file states; None if it states none."""
    if found := SOURCE.search(text):
        return _hz(found[1], "Hz"), _hz(found[1], "Hz")
    if re.search(r"^\s*HORIZONTAL\s+\d", text, re.I | re.M):
        if found := PLANET.search(text):
            unit = found[2] or found[4] or "MHz"
            low = _hz(found[1], unit)
            return low, max(low, _hz(found[3], found[4] or unit)) if found[3] else low
        return None
    if found := REPORT.search(text.split("\n", 1)[0]):
        return (_hz(found[1], found[2]), _hz(found[1], found[2])) if found[2] else None
    if found := FIELD.search(text):
        return _hz(found[1], "Hz"), _hz(found[1], "Hz")
    return None


def file_frequency_hz(path: Path) -> tuple[float, float] | None:
    """Return the lowest and highest frequency that a pattern file states; None if it states none."""
    with path.open("rb") as file:
        return stated_frequency_hz(file.read(HEAD_BYTES).decode("utf-8-sig", errors="replace"))


def _hz(number: str, unit: str) -> float:
    return float(number.replace(",", ".")) * UNITS_HZ[unit.lower()]
