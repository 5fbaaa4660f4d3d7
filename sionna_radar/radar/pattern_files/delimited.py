"""Patterns as delimited text: our CSV of cuts or of a grid, and the reports of HFSS."""

import csv
import re
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from sionna_radar.radar.pattern_files.contents import PatternCuts, PatternGrid
from sionna_radar.radar.pattern_files.grids import grid_of

CUTS = ("angle_deg", "azimuth_db", "elevation_db")
GRID = ("theta_deg", "phi_deg", "gain_db")
# A column of a report of HFSS: "dB(GainTotal) [] - Freq='77GHz' Phi='90deg'", with what it was varied by.
VARIED = re.compile(r"phi\s*=\s*'?\s*(-?[\d.]+)\s*deg", re.IGNORECASE)
FREQUENCY = re.compile(r"freq\s*=\s*'?\s*([\d.]+\s*\w*)", re.IGNORECASE)
MOST_COLUMNS = 10_000


def is_delimited(text: str) -> bool:
    """Whether a text begins with a header of ours or of HFSS."""
    head = text[:2000].lower()
    return "angle_deg" in head or ("theta" in head.split("\n", 1)[0] and "," in head.split("\n", 1)[0])


def read_delimited(text: str) -> PatternCuts | PatternGrid:
    """Return the pattern in a delimited text.

    Raises
    ------
    ValueError
        A column is missing, or a row holds something else than numbers.

    """
    rows = csv.reader(text.splitlines())
    header = [name.strip().strip('"') for name in next(rows, [])]
    names = [name.lower().replace("_dbi", "_db") for name in header]
    if len(names) > MOST_COLUMNS or len(set(names)) < len(names):
        message = f"line 1 has {len(names):,} columns, or one of them twice; give each once, at most {MOST_COLUMNS:,}"
        raise ValueError(message)
    lines, values = _numbers(rows, header)
    if set(CUTS) <= set(names):
        angle, azimuth, elevation = (values[:, names.index(name)] for name in CUTS)
        _check_angles(lines, angle)
        return _cuts(angle, azimuth, elevation)
    if set(GRID) <= set(names):
        return grid_of(*(values[:, names.index(name)] for name in GRID))
    return _report(header, values)


def _check_angles(lines: Sequence[int], angle_deg: Float[np.ndarray, " n"]) -> None:
    """Raise ValueError for angles that are no cut, naming the line of the first that is wrong."""
    if len(angle_deg) < 3:
        message = f"lines {lines[0]} to {lines[-1]} are {len(angle_deg)} angles; give three or more"
        raise ValueError(message)
    beyond = np.flatnonzero((angle_deg < -180) | (angle_deg > 180))
    falling = np.flatnonzero(np.diff(angle_deg) <= 0) + 1
    if len(beyond):
        message = f"line {lines[beyond[0]]} has angle_deg = {angle_deg[beyond[0]]:g}; give angles within -180 to 180"
        raise ValueError(message)
    if len(falling):
        at = falling[0]
        message = (
            f"line {lines[at]} has angle_deg = {angle_deg[at]:g} after {angle_deg[at - 1]:g}; it must increase from "
            "row to row"
        )
        raise ValueError(message)


def _cuts(
    angle: Float[np.ndarray, " n"], azimuth: Float[np.ndarray, " n"], elevation: Float[np.ndarray, " n"]
) -> PatternCuts:
    if angle[-1] - angle[0] > 360 - 1e-9 and azimuth[0] != azimuth[-1]:
        azimuth = np.append(azimuth[:-1], azimuth[0])  # -180 and 180 deg are one direction
    return PatternCuts(angle, azimuth, angle, elevation)


def _report(header: Sequence[str], values: Float[np.ndarray, "row column"]) -> PatternGrid:
    """Return a report of HFSS: theta, phi and power in columns, or theta and one column of power for each phi."""
    low = [name.lower() for name in header]
    theta = next((i for i, name in enumerate(low) if name.startswith("theta")), None)
    phi = next((i for i, name in enumerate(low) if name.startswith("phi")), None)
    power = [i for i, name in enumerate(low) if name.startswith("db(") or name.startswith("db10(")]
    if theta is None or not power:
        message = (
            f"line 1 names {', '.join(header[:6])}; give {', '.join(CUTS)}, or {', '.join(GRID)}, or a report of HFSS "
            "with Theta, Phi and a column in dB"
        )
        raise ValueError(message)
    if len({match.group(1) for i in power if (match := FREQUENCY.search(header[i]))}) > 1:
        message = "line 1 names several frequencies; export the one of the carrier"
        raise ValueError(message)
    if phi is not None and len(power) == 1:
        return grid_of(values[:, theta], values[:, phi], values[:, power[0]])
    varied = [(i, match) for i in power if (match := VARIED.search(header[i]))]
    if phi is not None or len(varied) != len(power):
        named = ", ".join(header[i] for i in power[:4])
        message = f"line 1 has several columns in dB ({named}); export one quantity, such as dB(GainTotal)"
        raise ValueError(message)
    count = len(values)
    return grid_of(
        np.tile(values[:, theta], len(varied)),
        np.repeat([float(match.group(1)) for _, match in varied], count),
        np.concatenate([values[:, i] for i, _ in varied]),
    )


def _numbers(rows: Iterator[list[str]], header: Sequence[str]) -> tuple[list[int], Float[np.ndarray, "row column"]]:
    """Return the numbers of the rows under a header, and the line of each."""
    expected = f"{len(header)} numbers ({', '.join(header)[:80]})"
    lines, found = [], []
    for number, row in enumerate(rows, start=2):
        if not row or not "".join(row).strip():
            continue
        try:
            values = [float(cell) for cell in row]
        except ValueError:
            values = []
        if len(values) != len(header) or np.isnan(values).any():
            message = f"line {number} holds {', '.join(row)[:60]!r}; expected {expected}"
            raise ValueError(message)
        lines.append(number)
        found.append(values)
    if not found:
        message = f"nothing follows line 1; expected rows of {expected}"
        raise ValueError(message)
    return lines, np.array(found)
