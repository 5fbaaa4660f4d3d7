"""Far fields as solvers export them as text: CST's tables (.txt) and sources (.ffs), HFSS's fields (.ffd)."""

import re
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from sionna_radar.radar.pattern_files.contents import FLOOR_DB, PatternGrid
from sionna_radar.radar.pattern_files.grids import grid_of

MOST_SAMPLES = 20_000_000


def is_cst_table(text: str) -> bool:
    """Whether a text is a table of CST: its first line names Theta and Phi with their units in brackets."""
    return bool(re.match(r"\s*theta\s*\[deg", text[:200], re.IGNORECASE))


def read_cst_table(text: str) -> PatternGrid:
    """Return the third column, the total, of a far-field table of CST, in dB or linear.

    Raises ValueError for rows that are not numbers.
    """
    lines = text.splitlines()
    name = re.split(r"\s{2,}|(?<=\])\s*", lines[0].strip())
    total = next((part for part in name if part.lower().startswith("abs")), "")
    table = [(at, line) for at, line in enumerate(lines[1:], start=2) if not line.strip().startswith("--")]
    values = _rows(table, ("theta", "phi", "total"))
    if "db" in total.lower():
        power = values[:, 2]
    else:  # fields are amplitudes, gains and directivities are not
        power = _decibels(values[:, 2] ** 2 if "v/m" in total.lower() else values[:, 2])
    return grid_of(values[:, 0], values[:, 1], power)


def is_cst_source(text: str) -> bool:
    """Whether a text is a far-field source of CST."""
    return text.lstrip().lower().startswith("// cst farfield source file")


def read_cst_source(text: str) -> PatternGrid:
    """Return a far-field source of CST: fields along theta and phi, phi by phi.

    Raises ValueError for a file of several frequencies, or without its fields.
    """
    frequencies = re.search(r"#\s*Frequencies\s*\n\s*(\d+)", text)
    if frequencies and int(frequencies.group(1)) != 1:
        message = f"it holds {frequencies.group(1)} frequencies; export the one of the carrier"
        raise ValueError(message)
    head = re.search(r"//[^\n]*Phi,\s*Theta,\s*Re\(E_Theta\)[^\n]*\n", text)
    if head is None:
        message = "expected a line '// >> Phi, Theta, Re(E_Theta), ...' over the table of fields, and found none"
        raise ValueError(message)
    first = text.count("\n", 0, head.end()) + 1
    table = list(enumerate(text[head.end() :].splitlines(), start=first))
    values = _rows(table, ("phi", "theta", "Re(E_Theta)", "Im(E_Theta)", "Re(E_Phi)", "Im(E_Phi)"))
    return grid_of(values[:, 1], values[:, 0], _decibels((values[:, 2:6] ** 2).sum(axis=1)))


def is_hfss_field(text: str) -> bool:
    """Whether a text begins like a field of HFSS: two lines of start, stop and count of theta and phi."""
    return bool(re.match(r"\s*(-?[\d.eE+-]+\s+-?[\d.eE+-]+\s+\d+\s*\n){2}", text[:400]))


def read_hfss_field(text: str) -> PatternGrid:
    """Return a field of HFSS: for each theta, for each phi, both components.

    Raises ValueError for a file of several frequencies, or of another number of rows than it says.
    """
    blank = len(text[: len(text) - len(text.lstrip())].splitlines())
    lines = text.lstrip().splitlines()
    axes = []
    for at, line in enumerate(lines[:2], start=1 + blank):
        start, stop, count = line.split()
        if not 2 <= int(count) <= 100_000:
            message = f"line {at} announces {count} angles along an axis; expected start, stop and 2 to 100,000 of them"
            raise ValueError(message)
        axes.append((float(start), float(stop), int(count)))
    size = axes[0][2] * axes[1][2]
    if size > MOST_SAMPLES:
        message = (
            f"lines {1 + blank} and {2 + blank} announce {size:,} directions, more than {MOST_SAMPLES:,}; export a "
            "coarser grid"
        )
        raise ValueError(message)
    named = [line for line in lines[2:20] if line[:4].lower() == "freq"]
    if len(named) > 2:
        message = "it holds several frequencies; export the one of the carrier"
        raise ValueError(message)
    table = [(at, line) for at, line in enumerate(lines[2:], start=3 + blank) if line[:4].lower() != "freq"]
    values = _rows(table, ("Re(E_Theta)", "Im(E_Theta)", "Re(E_Phi)", "Im(E_Phi)"))
    if len(values) != size:
        message = (
            f"lines {1 + blank} and {2 + blank} announce {size:,} directions, and {len(values):,} rows follow; export "
            "it anew"
        )
        raise ValueError(message)
    theta, phi = np.meshgrid(*(np.linspace(*axis) for axis in axes), indexing="ij")
    return grid_of(theta.ravel(), phi.ravel(), _decibels((values**2).sum(axis=1)))


def _rows(lines: Sequence[tuple[int, str]], columns: Sequence[str]) -> Float[np.ndarray, "row column"]:
    """Return the first columns of rows of numbers, given with their line in the file."""
    expected = f"{len(columns)} numbers ({', '.join(columns)})"
    found = []
    for number, line in lines:
        words = line.split()
        if not words:
            continue
        try:
            values = [float(word) for word in words[: len(columns)]]
        except ValueError:
            values = []
        if len(values) < len(columns) or not np.isfinite(values).all():
            message = f"line {number} holds {line.strip()[:60]!r}; expected {expected}"
            raise ValueError(message)
        found.append(values)
    if not found:
        message = f"its table is empty; expected rows of {expected}"
        raise ValueError(message)
    return np.array(found)


def _decibels(value: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return a linear quantity in decibels: a power ratio, as gain and directivity are."""
    if np.any(value < 0) or not value.max() > 0:
        message = "its gains are negative or all zero"
        raise ValueError(message)
    return 10 * np.log10(np.maximum(value / value.max(), 10 ** (FLOOR_DB / 10)))
