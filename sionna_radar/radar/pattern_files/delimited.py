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
        message = "line 1 has a column twice, or too many of them"
        raise ValueError(message)
    values = _numbers(rows, len(header))
    if set(CUTS) <= set(names):
        angle, azimuth, elevation = (values[:, names.index(name)] for name in CUTS)
        return _cuts(angle, azimuth, elevation)
    if set(GRID) <= set(names):
        return grid_of(*(values[:, names.index(name)] for name in GRID))
    return _report(header, values)


def _cuts(
    angle: Float[np.ndarray, " n"], azimuth: Float[np.ndarray, " n"], elevation: Float[np.ndarray, " n"]
) -> PatternCuts:
    if len(angle) < 3 or np.any(np.diff(angle) <= 0) or angle[0] < -180 or angle[-1] > 180:
        message = "angle_deg must increase from row to row, within -180 to 180, in three rows or more"
        raise ValueError(message)
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
        message = "it holds several frequencies; export the one of the carrier"
        raise ValueError(message)
    if phi is not None and len(power) == 1:
        return grid_of(values[:, theta], values[:, phi], values[:, power[0]])
    varied = [(i, match) for i in power if (match := VARIED.search(header[i]))]
    if phi is not None or len(varied) != len(power):
        message = "it has several columns in dB; export one quantity, such as dB(GainTotal)"
        raise ValueError(message)
    count = len(values)
    return grid_of(
        np.tile(values[:, theta], len(varied)),
        np.repeat([float(match.group(1)) for _, match in varied], count),
        np.concatenate([values[:, i] for i, _ in varied]),
    )


def _numbers(rows: Iterator[list[str]], columns: int) -> Float[np.ndarray, "row column"]:
    found = []
    for number, row in enumerate(rows, start=2):
        if not row or not "".join(row).strip():
            continue
        try:
            values = [float(cell) for cell in row]
        except ValueError:
            message = f"line {number} holds {', '.join(row)[:60]!r}; give numbers"
            raise ValueError(message) from None
        if len(values) != columns or np.isnan(values).any():
            message = f"line {number} has {len(values)} numbers, or one that is none; give {columns}"
            raise ValueError(message)
        found.append(values)
    if not found:
        message = "it has no rows under its header"
        raise ValueError(message)
    return np.array(found)
