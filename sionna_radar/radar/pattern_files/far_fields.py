"""Far fields as solvers export them as text: CST's tables (.txt) and sources (.ffs), HFSS's fields (.ffd)."""

import re

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
    values = _rows("\n".join(line for line in lines[1:] if not line.strip().startswith("--")), 3)
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
        message = "it lacks the table of fields, '>> Phi, Theta, Re(E_Theta), ...'"
        raise ValueError(message)
    values = _rows(text[head.end() :], 6)
    return grid_of(values[:, 1], values[:, 0], _decibels((values[:, 2:6] ** 2).sum(axis=1)))


def is_hfss_field(text: str) -> bool:
    """Whether a text begins like a field of HFSS: two lines of start, stop and count of theta and phi."""
    return bool(re.match(r"\s*(-?[\d.eE+-]+\s+-?[\d.eE+-]+\s+\d+\s*\n){2}", text[:400]))


def read_hfss_field(text: str) -> PatternGrid:
    """Return a field of HFSS: for each theta, for each phi, both components.

    Raises ValueError for a file of several frequencies, or of another number of rows than it says.
    """
    lines = text.lstrip().splitlines()
    axes = []
    for line in lines[:2]:
        start, stop, count = line.split()
        if not 2 <= int(count) <= 100_000:
            message = f"{count} angles along an axis; give 2 to 100,000"
            raise ValueError(message)
        axes.append((float(start), float(stop), int(count)))
    size = axes[0][2] * axes[1][2]
    if size > MOST_SAMPLES:
        message = f"it announces {size:,} directions, more than {MOST_SAMPLES:,}; export a coarser grid"
        raise ValueError(message)
    named = [line for line in lines[2:20] if line[:4].lower() == "freq"]
    if len(named) > 2:
        message = "it holds several frequencies; export the one of the carrier"
        raise ValueError(message)
    values = _rows("\n".join(line for line in lines[2:] if line[:4].lower() != "freq"), 4)
    if len(values) != size:
        message = f"it announces {size:,} directions, and holds {len(values):,}; export it anew"
        raise ValueError(message)
    theta, phi = np.meshgrid(*(np.linspace(*axis) for axis in axes), indexing="ij")
    return grid_of(theta.ravel(), phi.ravel(), _decibels((values**2).sum(axis=1)))


def _rows(text: str, columns: int) -> Float[np.ndarray, "row column"]:
    """Return the first columns of rows of numbers."""
    found = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        try:
            values = [float(word) for word in words[:columns]]
        except ValueError:
            message = f"row {number} of its table holds {line.strip()[:60]!r}; give numbers"
            raise ValueError(message) from None
        if len(values) < columns or not np.isfinite(values).all():
            message = f"row {number} of its table has fewer than {columns} numbers"
            raise ValueError(message)
        found.append(values)
    if not found:
        message = "its table is empty"
        raise ValueError(message)
    return np.array(found)


def _decibels(value: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return a linear quantity in decibels: a power ratio, as gain and directivity are."""
    if np.any(value < 0) or not value.max() > 0:
        message = "its gains are negative or all zero"
        raise ValueError(message)
    return 10 * np.log10(np.maximum(value / value.max(), 10 ** (FLOOR_DB / 10)))
