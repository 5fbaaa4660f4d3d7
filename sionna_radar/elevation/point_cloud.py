"""Point clouds (LAS, LAZ), read in pieces and gridded: memory does not grow with the number of points."""

import logging
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.foundation.errors import InputFileError, RadarError
from sionna_radar.foundation.input_file import regular_file, shown
from sionna_radar.foundation.raster import Grid, Raster

logger = logging.getLogger("sionna_radar")

KEY = "terrain.path"
REMEDY = "give a LAS or LAZ file"
MAX_BYTES = 200_000_000_000
MAX_POINTS = 20_000_000_000
POINTS_AT_ONCE = 1_000_000
GROUND_CLASS = 2
NOISE_CLASSES = (7, 18)
# Whatever the datum of the heights, a point beyond is no ground.
FARTHEST_HEIGHT_M = 100_000.0
# A percentile is found by narrowing the range of heights of each cell, so many parts at a time, so many times.
PARTS, NARROWINGS = 16, 3

# Which points are taken: by a name, or by their classes.
Choice = Literal["first", "ground", "all"] | tuple[int, ...]
Piece = tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]
Place = Callable[[Float[np.ndarray, " n"], Float[np.ndarray, " n"]], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, kw_only=True)
class CloudFile:
    """An open point cloud.

    points: how many the file says that it has. low, high: its bounds (x, y, z), in its own units.
    crs_wkt: its CRS; None if it has none.
    """

    reader: Any
    name: str
    points: int
    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]
    crs_wkt: str | None

    def pieces(self, choice: Choice, place: Place, unit_m: float) -> Iterator[Piece]:
        """Yield local positions and heights in metres of the chosen points, a piece of the file at a time.

        Points withheld or classified as noise are left out. Each call reads the file anew.
        """
        with _errors(self.name):
            self.reader.seek(0)
            for points in self.reader.chunk_iterator(POINTS_AT_ONCE):
                kept = _chosen(points, choice)
                with np.errstate(all="ignore"):  # scales and offsets of a damaged header
                    x, y = place(np.asarray(points.x)[kept], np.asarray(points.y)[kept])
                    z = np.asarray(points.z)[kept] * unit_m
                finite = np.isfinite(x) & np.isfinite(y) & (np.abs(z) < FARTHEST_HEIGHT_M)
                yield np.column_stack([x, y])[finite], z[finite]


def _chosen(points: Any, choice: Choice) -> Bool[np.ndarray, " n"]:
    kind = np.asarray(points.classification)
    kept = ~np.isin(kind, NOISE_CLASSES) & (np.asarray(points.withheld) == 0)
    if isinstance(choice, tuple):
        kept &= np.isin(kind, choice)
    elif choice == "first":
        kept &= np.asarray(points.return_number) <= 1
    elif choice == "ground":
        kept &= kind == GROUND_CLASS
    return kept


@contextmanager
def open_cloud(path: Path, key: str = KEY) -> Iterator[CloudFile]:
    """Open a LAS or LAZ file that a key of the scenario names.

    Raises InputFileError for a file that is none, claims more points than it can hold, or breaks off.
    """
    import laspy

    size = regular_file(path, f"{key} =", REMEDY, MAX_BYTES)
    name = f"{key} = {shown(path)}"
    _check_records(path, size, name)
    with _errors(name):
        reader = laspy.open(path, read_evlrs=False)
    with reader:
        with _errors(name):
            header = reader.header
            points = int(header.point_count)
            start, stored = int(header.offset_to_point_data), points * int(header.point_format.size)
            crs = header.parse_crs(prefer_wkt=True)
            low, high = np.array(header.mins, dtype=float), np.array(header.maxs, dtype=float)
        if points < 3:
            message = f"{name}: has {points} points, too few for a surface; {REMEDY} with more"
            raise InputFileError(message)
        if points > MAX_POINTS or (not header.are_points_compressed and start + stored > size):
            message = f"{name}: claims {points:,} points, more than its {size:,} bytes can hold; get the whole file"
            raise InputFileError(message)
        if header.are_points_compressed:
            _check_chunks(path, start, size, points, name)
        if not (np.isfinite(low).all() and np.isfinite(high).all() and (low <= high).all()):
            message = f"{name}: its header has no valid bounds; write it anew, for example with PDAL"
            raise InputFileError(message)
        wkt = crs.to_wkt() if crs is not None else None
        yield CloudFile(reader=reader, name=name, points=points, low=low, high=high, crs_wkt=wkt)


def _check_records(path: Path, size: int, name: str) -> None:
    """Refuse a header with more variable-length records than there is room for: the reader would make them all.

    Those of 54 bytes and more stand between the header and the points, the extended ones of LAS 1.4, of 60 and more,
    behind them (ASPRS 2019, "LAS Specification 1.4 - R15", tables 3, 5 and 6).
    """
    with path.open("rb") as file:
        head = file.read(247).ljust(247, b"\0")
    header, points, records = struct.unpack_from("<HII", head, 94)
    first, extended = struct.unpack_from("<QI", head, 235) if head[25] >= 4 else (0, 0)
    for count, each, room, kind in (
        (records, 54, min(points, size) - header, "variable-length records"),
        (extended, 60, size - first, "extended variable-length records"),
    ):
        if head.startswith(b"LASF") and each * count > max(room, 0):
            message = f"{name}: its header claims {count:,} {kind}, more than its bytes can hold; get the whole file"
            raise InputFileError(message)


def _check_chunks(path: Path, start: int, size: int, points: int, name: str) -> None:
    """Refuse a LAZ file whose table of chunks lies, before the decompressor sets memory aside for it and dies.

    The compressed points begin with the place of the table, -1 for the last 8 bytes of the file; the table with its
    version and the number of chunks, of at least one byte each (Isenburg 2013, "LASzip: lossless compression of LiDAR
    data").
    """
    with path.open("rb") as file:
        file.seek(min(start, size))
        place = int.from_bytes(file.read(8), "little", signed=True)
        if place == -1:
            file.seek(max(size - 8, 0))
            place = int.from_bytes(file.read(8), "little", signed=True)
        file.seek(place if 0 <= place <= size else size)
        head = file.read(8)
    chunks = int.from_bytes(head[4:8], "little")
    if not start < place <= size - 8 or len(head) < 8 or chunks > min(size, points):
        message = f"{name}: its table of compressed chunks is damaged; get the whole file"
        raise InputFileError(message)


@contextmanager
def _errors(name: str) -> Iterator[None]:
    """Turn whatever the readers of LAS and LAZ raise into one error of ours."""
    try:
        yield
    except (RadarError, GeneratorExit, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # the decompressor's own panics are no Exception
        reason = (str(error) or type(error).__name__).splitlines()[0][:200]
        message = f"{name} cannot be read as a point cloud ({reason}); {REMEDY}"
        raise InputFileError(message) from None


def gridded(
    pieces: Callable[[], Iterator[Piece]], grid: Grid, statistic: Literal["mean", "max", "percentile"], share: float
) -> Raster:
    """Return a statistic of the heights of the points in each cell, NaN where there are none.

    Parameters
    ----------
    pieces:
        Yields all points anew in each call; a percentile needs several.
    grid:
        The cells.
    statistic:
        The mean, the highest, or the height that a share of the points of a cell does not exceed.
    share:
        For the percentile, from 0 to 1; found to within 1/4096 of a cell's range of heights.

    """
    if statistic == "mean":
        total, count = np.zeros(grid.rows * grid.columns), np.zeros(grid.rows * grid.columns)
        for cell, z in _in_cells(pieces(), grid):
            total += np.bincount(cell, z, minlength=len(total))
            count += np.bincount(cell, minlength=len(count))
        with np.errstate(invalid="ignore"):
            return _raster(grid, total / np.where(count > 0, count, np.nan))
    low, high = np.full(grid.rows * grid.columns, np.inf), np.full(grid.rows * grid.columns, -np.inf)
    for cell, z in _in_cells(pieces(), grid):
        np.maximum.at(high, cell, z)
        np.minimum.at(low, cell, z)
    high[~np.isfinite(high)] = np.nan
    if statistic == "max":
        return _raster(grid, high)
    return _raster(grid, _percentile(pieces, grid, share, low, high))


def _percentile(
    pieces: Callable[[], Iterator[Piece]],
    grid: Grid,
    share: float,
    low: Float[np.ndarray, " cell"],
    high: Float[np.ndarray, " cell"],
) -> Float[np.ndarray, " cell"]:
    """Return a percentile of each cell by narrowing the part of its range that holds it."""
    low, width = np.where(np.isfinite(high), low, 0.0), np.where(np.isfinite(high), high - low, 0.0)
    rank: Float[np.ndarray, " cell"] | None = None
    for _ in range(NARROWINGS):
        count = np.zeros((len(low), PARTS), dtype=np.uint32)
        below = np.zeros(len(low))
        for cell, z in _in_cells(pieces(), grid):
            part = np.floor((z - low[cell]) / np.where(width[cell] > 0, width[cell] / PARTS, 1.0)).astype(np.int64)
            # The highest point of a cell belongs to its last part.
            part = np.where((part == PARTS) & (z <= low[cell] + width[cell] * (1 + 1e-9)), PARTS - 1, part)
            below += np.bincount(cell[part < 0], minlength=len(low))
            inside = (part >= 0) & (part < PARTS)
            np.add.at(count, (cell[inside], part[inside]), 1)
        if rank is None:
            rank = share * np.maximum(count.sum(axis=1) - 1, 0)
        reached = below[:, None] + np.cumsum(count, axis=1) > rank[:, None]
        chosen = np.where(reached.any(axis=1), np.argmax(reached, axis=1), PARTS - 1)
        width = width / PARTS
        low = low + chosen * width
    return np.where(np.isfinite(high), low + width / 2, np.nan)


def _in_cells(pieces: Iterator[Piece], grid: Grid) -> Iterator[tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]]:
    """Yield the cells and the heights of the points within a grid."""
    west, east, south, north = grid.extent_m
    for place_m, z in pieces:
        x, y = place_m.T
        near = (x >= west) & (x <= east) & (y >= south) & (y <= north)
        row, column, inside = grid.cell_of(place_m[near])
        yield (row * grid.columns + column)[inside], z[near][inside]


def _raster(grid: Grid, height_m: Float[np.ndarray, " cell"]) -> Raster:
    return Raster(grid=grid, height_m=height_m.reshape(grid.shape))
