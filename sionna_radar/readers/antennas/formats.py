"""Formats of antenna patterns: MSI Planet cuts, delimited tables, and exports of far fields.

In Planet files horizontal angles turn clockwise seen from above, so to the right of boresight; vertical ones from
boresight downward, or, in files of some makers, from the zenith.

Delimited text is our CSV of cuts or of a grid, or a report of HFSS. Far fields are those that solvers export as text:
CST's tables (.txt) and sources (.ffs), HFSS's fields (.ffd).
"""

import csv
import re
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from sionna_radar.readers.antennas.contents import FLOOR_DB, PatternCuts, PatternGrid, grid_of

SECTIONS = ("HORIZONTAL", "VERTICAL")
MAX_ROWS = 100_000


def is_planet(text: str) -> bool:
    """Whether a text has the two sections of a Planet file."""
    upper = text.upper()
    return all(f"\n{section}" in f"\n{upper}" for section in SECTIONS)


def read_planet(text: str) -> PatternCuts:
    """Return the cuts of a Planet file.

    Raises ValueError for a missing section, another number of rows than in its header, and rows of no angle and loss.
    """
    lines = text.splitlines()
    cuts = {}
    for number, line in enumerate(lines):
        words = line.split()
        if words and words[0].upper() in SECTIONS:
            cuts[words[0].upper()] = _section(lines, number, words)
    if set(cuts) != set(SECTIONS):
        missing = ", ".join(section for section in SECTIONS if section not in cuts)
        raise ValueError(f"expected a line with {missing} and a number of rows, and found none")
    (horizontal, horizontal_loss), (vertical, vertical_loss) = (cuts[section] for section in SECTIONS)
    azimuth, elevation = _turned(horizontal, horizontal_loss), _turned(vertical, vertical_loss)
    return PatternCuts(*azimuth, *elevation, turnable=True)


def _section(
    lines: list[str], header_line: int, words: list[str]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    if len(words) != 2 or not words[1].isdecimal() or not 3 <= int(words[1]) <= MAX_ROWS:
        raise ValueError(
            f"line {header_line + 1} holds {lines[header_line].strip()[:60]!r}; expected {words[0].upper()} and how "
            f"many rows follow, 3 to {MAX_ROWS:,}"
        )
    count = int(words[1])
    rows = list(enumerate(lines[header_line + 1 : header_line + 1 + count], start=header_line + 2))
    expected = f"an angle and a loss, as line {header_line + 1} announces {count} rows of them"
    table = _table([(number, row, row.replace(",", ".").split()) for number, row in rows], 2, expected)
    if len(rows) < count:
        raise ValueError(
            f"line {header_line + 1} announces {count} rows of an angle and a loss; the file ends after {len(rows)}"
        )
    return table[:, 0], table[:, 1]


def _turned(
    angle_deg: Float[np.ndarray, " n"], loss_db: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return sign-reversed angles, increasing from -180 to 180, and powers."""
    angle = -((angle_deg + 180) % 360 - 180)
    angle, unique_row = np.unique(angle, return_index=True)
    # Losses are positive; some files list negative powers instead.
    return angle, -np.abs(loss_db[unique_row])


CUTS = ("angle_deg", "azimuth_db", "elevation_db")
GRID = ("theta_deg", "phi_deg", "gain_db")
# A column of a report of HFSS: "dB(GainTotal) [] - Freq='77GHz' Phi='90deg'", with what it was varied by.
VARIED = re.compile(r"phi\s*=\s*'?\s*(-?[\d.]+)\s*deg", re.IGNORECASE)
FREQUENCY = re.compile(r"freq\s*=\s*'?\s*([\d.]+\s*\w*)", re.IGNORECASE)
MAX_COLUMNS = 10_000


def is_delimited(text: str) -> bool:
    """Whether a text begins with a header of ours or of HFSS."""
    head = text[:2000].lower()
    return "angle_deg" in head or ("theta" in head.split("\n", 1)[0] and "," in head.split("\n", 1)[0])


def read_delimited(text: str) -> PatternCuts | PatternGrid:
    """Return the pattern in a delimited text; ValueError for a missing column, or a cell that is not a number."""
    rows = csv.reader(text.splitlines())
    header = [name.strip().strip('"') for name in next(rows, [])]
    names = [name.lower().replace("_dbi", "_db") for name in header]
    if len(names) > MAX_COLUMNS or len(set(names)) < len(names):
        message = f"line 1 has {len(names):,} columns, or one of them twice; give each once, at most {MAX_COLUMNS:,}"
        raise ValueError(message)
    lines, values = _numbers(rows, header)
    if set(CUTS) <= set(names):
        angle, azimuth, elevation = (values[:, names.index(name)] for name in CUTS)
        _check_angles(lines, angle)
        if angle[-1] - angle[0] > 360 - 1e-9 and azimuth[0] != azimuth[-1]:
            azimuth = np.append(azimuth[:-1], azimuth[0])  # -180 and 180 deg are one direction
        return PatternCuts(angle, azimuth, angle, elevation)
    if set(GRID) <= set(names):
        return grid_of(*(values[:, names.index(name)] for name in GRID))
    return _report(header, values)


def _check_angles(lines: Sequence[int], angle_deg: Float[np.ndarray, " n"]) -> None:
    """Raise ValueError, with the line of the first wrong angle, for angles that do not form a cut."""
    if len(angle_deg) < 3:
        raise ValueError(f"lines {lines[0]} to {lines[-1]} are {len(angle_deg)} angles; give three or more")
    wide = np.flatnonzero((angle_deg < -180) | (angle_deg > 180))
    not_increasing = np.flatnonzero(np.diff(angle_deg) <= 0) + 1
    if len(wide):
        message = f"line {lines[wide[0]]} has angle_deg = {angle_deg[wide[0]]:g}; give angles within -180 to 180"
        raise ValueError(message)
    if len(not_increasing):
        row = not_increasing[0]
        raise ValueError(
            f"line {lines[row]} has angle_deg = {angle_deg[row]:g} after {angle_deg[row - 1]:g}; it must increase from "
            "row to row"
        )


def _report(header: Sequence[str], values: Float[np.ndarray, "row column"]) -> PatternGrid:
    """Return a report of HFSS: theta, phi and power in columns, or theta and one column of power for each phi."""
    names = [name.lower() for name in header]
    theta = next((i for i, name in enumerate(names) if name.startswith("theta")), None)
    phi = next((i for i, name in enumerate(names) if name.startswith("phi")), None)
    power = [i for i, name in enumerate(names) if name.startswith("db(") or name.startswith("db10(")]
    if theta is None or not power:
        raise ValueError(
            f"line 1 names {', '.join(header[:6])}; give {', '.join(CUTS)}, or {', '.join(GRID)}, or a report of HFSS "
            "with Theta, Phi and a column in dB"
        )
    if len({match.group(1) for i in power if (match := FREQUENCY.search(header[i]))}) > 1:
        raise ValueError("line 1 names several frequencies; export the one of the carrier")
    if phi is not None and len(power) == 1:
        return grid_of(values[:, theta], values[:, phi], values[:, power[0]])
    by_phi = [(i, match) for i in power if (match := VARIED.search(header[i]))]
    if phi is not None or len(by_phi) != len(power):
        columns = ", ".join(header[i] for i in power[:4])
        raise ValueError(f"line 1 has several columns in dB ({columns}); export one quantity, such as dB(GainTotal)")
    count = len(values)
    return grid_of(
        np.tile(values[:, theta], len(by_phi)),
        np.repeat([float(match.group(1)) for _, match in by_phi], count),
        np.concatenate([values[:, i] for i, _ in by_phi]),
    )


def _numbers(rows: Iterator[list[str]], header: Sequence[str]) -> tuple[list[int], Float[np.ndarray, "row column"]]:
    """Return the numbers of the rows under a header, and the line of each."""
    expected = f"{len(header)} numbers ({', '.join(header)[:80]})"
    filled = [(number, row) for number, row in enumerate(rows, start=2) if "".join(row).strip()]
    if not filled:
        raise ValueError(f"nothing follows line 1; expected rows of {expected}")
    table = _table([(number, ", ".join(row), row) for number, row in filled], len(header), expected, infinite=True)
    return [number for number, _ in filled], table


MAX_SAMPLES = 20_000_000
# The total's column of a table of CST, such as "Abs(E   )[V/m   ]", and a unit in it that is one of fields.
TOTAL = re.compile(r"abs\(.*?\)\s*(?:\[[^]]*\])?", re.IGNORECASE)
OF_FIELDS = re.compile(r"[va]/m(?![\^2²])", re.IGNORECASE)


def is_cst_table(text: str) -> bool:
    """Whether a text is a table of CST: its first line names Theta and Phi with their units in brackets."""
    return bool(re.match(r"\s*theta\s*\[deg", text[:200], re.IGNORECASE))


def read_cst_table(text: str) -> PatternGrid:
    """Return the third column, the total, of a far-field table of CST, in dB or linear; ValueError for no numbers."""
    lines = text.splitlines()
    total = found[0] if (found := TOTAL.search(lines[0])) else ""
    table = [(number, line) for number, line in enumerate(lines[1:], start=2) if not line.strip().startswith("--")]
    values = _rows(table, ("theta", "phi", "total"))
    if "db" in total.lower():
        power = values[:, 2]
    else:  # fields are amplitudes, gains and directivities are not
        power = _decibels(values[:, 2] ** 2 if OF_FIELDS.search(total) else values[:, 2])
    return grid_of(values[:, 0], values[:, 1], power)


def is_cst_source(text: str) -> bool:
    """Whether a text is a far-field source of CST."""
    return text.lstrip().lower().startswith("// cst farfield source file")


def read_cst_source(text: str) -> PatternGrid:
    """Return a far-field source of CST, fields phi by phi; ValueError for several frequencies, or without fields."""
    frequencies = re.search(r"#\s*Frequencies\s*\n\s*(\d+)", text)
    if frequencies and int(frequencies.group(1)) != 1:
        raise ValueError(f"it holds {frequencies.group(1)} frequencies; export the one of the carrier")
    head = re.search(r"//[^\n]*Phi,\s*Theta,\s*Re\(E_Theta\)[^\n]*\n", text)
    if head is None:
        message = "expected a line '// >> Phi, Theta, Re(E_Theta), ...' over the table of fields, and found none"
        raise ValueError(message)
    table_line = text.count("\n", 0, head.end()) + 1
    table = list(enumerate(text[head.end() :].splitlines(), start=table_line))
    values = _rows(table, ("phi", "theta", "Re(E_Theta)", "Im(E_Theta)", "Re(E_Phi)", "Im(E_Phi)"))
    return grid_of(values[:, 1], values[:, 0], _decibels((values[:, 2:6] ** 2).sum(axis=1)))


def is_hfss_field(text: str) -> bool:
    """Whether a text begins like a field of HFSS: two lines of start, stop and count of theta and phi."""
    return bool(re.match(r"\s*(-?[\d.eE+-]+\s+-?[\d.eE+-]+\s+\d+\s*\n){2}", text[:400]))


def read_hfss_field(text: str) -> PatternGrid:
    """Return a field of HFSS, theta by theta; ValueError for several frequencies, or too many or few rows."""
    blank = len(text[: len(text) - len(text.lstrip())].splitlines())
    lines = text.lstrip().splitlines()
    axes = []
    for number, line in enumerate(lines[:2], start=1 + blank):
        start, stop, count = line.split()
        if not 2 <= int(count) <= 100_000:
            raise ValueError(
                f"line {number} announces {count} angles along an axis; expected start, stop and 2 to 100,000 of them"
            )
        axes.append((float(start), float(stop), int(count)))
    size = axes[0][2] * axes[1][2]
    if size > MAX_SAMPLES:
        raise ValueError(
            f"lines {1 + blank} and {2 + blank} announce {size:,} directions, more than {MAX_SAMPLES:,}; export a "
            "coarser grid"
        )
    frequencies = [line for line in lines[2:20] if line[:4].lower() == "freq"]
    if len(frequencies) > 2:
        raise ValueError("it holds several frequencies; export the one of the carrier")
    table = [(number, line) for number, line in enumerate(lines[2:], start=3 + blank) if line[:4].lower() != "freq"]
    values = _rows(table, ("Re(E_Theta)", "Im(E_Theta)", "Re(E_Phi)", "Im(E_Phi)"))
    if len(values) != size:
        raise ValueError(
            f"lines {1 + blank} and {2 + blank} announce {size:,} directions, and {len(values):,} rows follow; export "
            "it anew"
        )
    theta, phi = np.meshgrid(*(np.linspace(*axis) for axis in axes), indexing="ij")
    return grid_of(theta.ravel(), phi.ravel(), _decibels((values**2).sum(axis=1)))


def _rows(lines: Sequence[tuple[int, str]], columns: Sequence[str]) -> Float[np.ndarray, "row column"]:
    """Return the first columns of rows of numbers, given with their line in the file."""
    count = len(columns)
    expected = f"{count} numbers ({', '.join(columns)})"
    filled = [(number, line, line.split()[:count]) for number, line in lines if line.strip()]
    if not filled:
        raise ValueError(f"its table is empty; expected rows of {expected}")
    return _table(filled, count, expected)


def _table(
    rows: Sequence[tuple[int, str, Sequence[str]]], columns: int, expected: str, *, infinite: bool = False
) -> Float[np.ndarray, "row column"]:
    """Return rows of numbers, each given as the line in the file, its text and its cells."""
    table = []
    for number, text, cells in rows:
        try:
            values = [float(cell) for cell in cells]
        except ValueError:
            values = []
        if len(values) != columns or np.isnan(values).any() or not (infinite or np.isfinite(values).all()):
            raise ValueError(f"line {number} holds {text.strip()[:60]!r}; expected {expected}")
        table.append(values)
    return np.array(table)


def _decibels(value: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return a linear quantity in decibels: a power ratio, as gain and directivity are."""
    if np.any(value < 0) or not value.max() > 0:
        raise ValueError("its gains are negative or all zero")
    return 10 * np.log10(np.maximum(value / value.max(), 10 ** (FLOOR_DB / 10)))
