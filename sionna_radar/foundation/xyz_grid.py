"""Reader of `.xyz` text grids, `x y z` on each line: the digital terrain models (DGM1) of German states and others.

Lines may stand in any order, cells may be missing, and tiles may follow each other in one file (`cat *.xyz`), where
GDAL's own driver wants rows in order. Columns are separated by spaces, tabs, commas or semicolons, and lines that begin
with a letter or # are headers. Coordinates are the middles of cells.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Float64, Int

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import regular_file, shown

SUFFIX = ".xyz"
MAX_BYTES = 4_000_000_000
# Points of a file, and cells of the box about them; and lines that are parsed at a time.
MAX_POINTS, MAX_CELLS = 50_000_000, 100_000_000
LINES_AT_ONCE = 500_000
LONGEST_LINE = 10_000
# How far a point may lie from its place in the grid, in cells: coordinates are written with few decimals.
OFF_GRID = 0.05
REMEDY = "give lines of x y z, or grid the points: as LAS or LAZ with terrain.kind = 'points', or with gdal_grid"


class XyzGrid(NamedTuple):
    """Heights of a text grid, rows from north to south; NaN where there is none.

    west, north: middle of the first cell. steps: distances of cells, east and north.
    """

    west: float
    north: float
    steps: tuple[float, float]
    height: Float32[np.ndarray, "row column"]


def read_xyz(path: Path, name: str) -> XyzGrid:
    """Return the grid in a text file; InputFileError for one whose points do not lie on a grid.

    name: beginning of messages: what named the file.
    """
    regular_file(path, name, REMEDY, MAX_BYTES)
    label = f"{name} {shown(path)}"
    x, y, z = _points(path, label).T
    column, west, step_x = _places(x, label, "x")
    row, south, step_y = _places(y, label, "y")
    columns, rows = int(column.max()) + 1, int(row.max()) + 1
    if columns * rows > MAX_CELLS:
        message = f"spans {columns:,} x {rows:,} cells, more than {MAX_CELLS:,}; give fewer tiles, side by side"
        raise InputFileError(f"{label}: {message}")
    height: Float32[np.ndarray, "row column"] = np.full((rows, columns), np.nan, np.float32)
    height[rows - 1 - row, column] = z
    return XyzGrid(west=west, north=south + (rows - 1) * step_y, steps=(step_x, step_y), height=height)


def _points(path: Path, label: str) -> Float64[np.ndarray, "point 3"]:
    """Return the numbers of all lines."""
    pieces, count = [], 0
    try:
        with path.open(encoding="utf-8-sig") as file:
            for first, lines in _blocks(file, label):
                try:
                    piece = np.loadtxt(lines, dtype=np.float64, usecols=(0, 1, 2), ndmin=2, comments=None)
                except (ValueError, IndexError) as error:
                    raise InputFileError(f"{label}: {_bad_line(lines, first)}; {REMEDY}") from error
                pieces.append(piece)
                count += len(piece)
                if count > MAX_POINTS:
                    raise InputFileError(f"{label}: has more than {MAX_POINTS:,} points; give fewer tiles")
    except (UnicodeDecodeError, OSError) as error:
        raise InputFileError(f"{label} is not text ({str(error)[:100]}); {REMEDY}") from error
    points = np.concatenate(pieces) if pieces else np.empty((0, 3))
    if not np.isfinite(points[:, :2]).all():
        raise InputFileError(f"{label}: a coordinate is not a finite number; {REMEDY}")
    return points


def _blocks(file: Iterator[str], label: str) -> Iterator[tuple[int, list[str]]]:
    """Yield lines of numbers, their columns separated by spaces, with the number of the first."""
    lines: list[str] = []
    first = 1
    for number, line in enumerate(file, start=1):
        if len(line) > LONGEST_LINE:
            raise InputFileError(f"{label}: line {number} has {len(line):,} characters; {REMEDY}")
        text = line.strip()
        if not text or text[0] in "#\"'" or (text[0].isalpha() and not lines):
            continue
        first = first if lines else number
        lines.append(text.replace(",", " ").replace(";", " "))
        if len(lines) >= LINES_AT_ONCE:
            yield first, lines
            lines = []
    if lines:
        yield first, lines


def _bad_line(lines: list[str], first: int) -> str:
    for number, line in enumerate(lines, start=first):
        try:
            [float(word) for word in line.split()[:3]]
        except ValueError:
            return f"line {number} or after reads {shown(line)}"
        if len(line.split()) < 3:
            return f"line {number} or after reads {shown(line)}"
    return f"cannot be read after line {first}"


def _places(
    values: Float[np.ndarray, " point"], label: str, axis: str
) -> tuple[Int[np.ndarray, " point"], float, float]:
    """Return the number of each coordinate in its axis of the grid, the least one, and their distance."""
    distinct, which = np.unique(values, return_inverse=True)
    step_sizes = np.diff(distinct)
    if len(step_sizes) == 0:
        raise InputFileError(f"{label}: all points have the same {axis}; {REMEDY}")
    # Counted from one coordinate to the next: distances that are rounded do not add up.
    with np.errstate(over="ignore", invalid="ignore"):
        number = np.concatenate([[0.0], np.cumsum(np.rint(step_sizes / step_sizes.min()))])
        step = float((distinct[-1] - distinct[0]) / number[-1])
        off = np.abs((distinct - distinct[0]) / step - number)
    if not (np.isfinite(number[-1]) and number[-1] < MAX_CELLS and off.max() <= OFF_GRID):
        at = distinct[int(np.argmin(step_sizes)) + 1]
        message = f"{axis} = {at:.10g} is {step_sizes.min():.3g} from its neighbour, and others are no multiples of it"
        raise InputFileError(f"{label}: the points do not form a grid: {message}, or there are too many; {REMEDY}")
    return number.astype(np.int64)[which], float(distinct[0]), step
