"""Reading a radar cross-section by angle from a CSV file."""

import csv
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import read_text, shown
from sionna_radar.scene.motion import RcsTable

AZIMUTH, ELEVATION, RCS = "azimuth_deg", "elevation_deg", "rcs_dbsm"
REMEDY = f"give a CSV file with the columns {AZIMUTH},{RCS}, and {ELEVATION} if it depends on that"
MOST_ROWS = 1_000_000


def read_rcs(path: Path) -> RcsTable:
    """Return the table in a file; raises InputFileError for a file that holds none."""
    rows = [line for line in read_text(path, "rcs_table", REMEDY).splitlines() if line.strip() and line[0] != "#"]
    try:
        header = [name.strip() for name in next(csv.reader(rows[:1]), [])]
        numbers = [[float(cell) for cell in row] for row in csv.reader(rows[1:])]
        _check(header, numbers)
        return _table(header, np.array(numbers))
    except (ValueError, csv.Error) as error:
        message = f"{shown(path)} holds no radar cross-section by angle ({error}); {REMEDY}"
        raise InputFileError(message) from error


def _check(header: list[str], numbers: list[list[float]]) -> None:
    """Raise ValueError for other columns, for too many rows or none, and for what is not finite."""
    if set(header) not in ({AZIMUTH, RCS}, {AZIMUTH, ELEVATION, RCS}) or len(set(header)) != len(header):
        message = f"its header is {shown(','.join(header))}"
        raise ValueError(message)
    if not 1 <= len(numbers) <= MOST_ROWS or any(len(row) != len(header) for row in numbers):
        message = f"its rows are not from 1 to {MOST_ROWS:,} of {len(header)} numbers each"
        raise ValueError(message)
    if not np.all(np.isfinite(numbers)):
        message = "not all of its numbers are finite"
        raise ValueError(message)


def _table(header: list[str], values: Float[np.ndarray, "row column"]) -> RcsTable:
    azimuth, rcs_db = values[:, header.index(AZIMUTH)], values[:, header.index(RCS)]
    elevation = values[:, header.index(ELEVATION)] if ELEVATION in header else np.zeros(len(values))
    if np.ptp(azimuth) >= 360 or np.abs(elevation).max() > 90 or np.abs(rcs_db).max() > 200:
        message = "azimuths cover a turn or more (leave out the last), elevations exceed 90, or levels 200 dB"
        raise ValueError(message)
    columns, column = np.unique(azimuth, return_inverse=True)
    heights, row = np.unique(elevation, return_inverse=True)
    if len(columns) * len(heights) != len(values) or len(set(zip(row, column, strict=True))) != len(values):
        message = "there is not one row for each azimuth at each elevation"
        raise ValueError(message)
    rcs_m2 = np.empty((len(heights), len(columns)))
    rcs_m2[row, column] = 10 ** (rcs_db / 10)
    return RcsTable(azimuth_rad=np.deg2rad(columns), elevation_rad=np.deg2rad(heights), rcs_m2=rcs_m2)
