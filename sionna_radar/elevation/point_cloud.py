"""Reading and gridding of LAS and LAZ point clouds in pieces, so that memory does not grow with their size."""

import logging
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from pyproj import CRS

from sionna_radar.elevation.file_heights import MAX_HEIGHT_M
from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.elevation.placed_raster import Coordinates, HeightSystem
from sionna_radar.foundation.city_models import refuse_city_model
from sionna_radar.foundation.deferred import REQUESTS, deferred
from sionna_radar.foundation.errors import InputFileError, RadarError, reason_of
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
# Classes of points by cover (ASPRS 2019, "LAS Specification 1.4 - R15", table 17).
COVERS = {
    "ground": (2, 8),
    "low vegetation": (3,),
    "medium vegetation": (4,),
    "high vegetation": (5,),
    "building": (6,),
    "water": (9,),
    "road or rail": (10, 11),
    "bridge": (17,),
}
# Bins per pass and number of passes of the histogram search for a percentile.
PARTS, NARROWINGS = 16, 3

# Selection of points by a name, or by their classes.
Choice = Literal["first", "ground", "all"] | tuple[int, ...]
Piece = tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]
Place = Callable[[Float[np.ndarray, " n"], Float[np.ndarray, " n"]], Coordinates]


@dataclass(frozen=True, kw_only=True)
class CloudFile:
    """An open point cloud.

    points: number in the header. low, high: bounds (x, y, z), in the file's units.
    crs_wkt: its CRS; None if it has none.
    warned: what was said of its points, which are read several times.
    """

    reader: Any
    name: str
    points: int
    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]
    crs_wkt: str | None
    warned: list[str] = field(default_factory=list)

    @property
    def middle(self) -> tuple[float, float]:
        """Middle of its bounds, in the file's units."""
        return float(self.low[0] + self.high[0]) / 2, float(self.low[1] + self.high[1]) / 2

    def extent_m(self, place: Place) -> tuple[float, float, float, float]:
        """Return west, south, east and north of the corners of its bounds."""
        corner_x, corner_y = (axis.ravel() for axis in np.meshgrid(*np.column_stack([self.low, self.high])[:2]))
        x, y = place(corner_x, corner_y)
        return float(np.min(x)), float(np.min(y)), float(np.max(x)), float(np.max(y))

    def pieces(self, choice: Choice, place: Place, unit_m: float, dimension: str | None = None) -> Iterator[Piece]:
        """Yield local positions and heights in metres of the chosen points, a piece of the file at a time.

        Points withheld or classified as noise are omitted. Each call reads the file again.
        dimension: name of a dimension, such as `classification`, whose values are yielded instead of the heights.
        """
        with _errors(self.name):
            self.reader.seek(0)
            for points in self.reader.chunk_iterator(POINTS_AT_ONCE):
                chosen = _chosen(points, choice)
                with np.errstate(all="ignore"):  # scales and offsets of a damaged header
                    x, y = place(np.asarray(points.x)[chosen], np.asarray(points.y)[chosen])
                    z = np.asarray(points.z)[chosen] * unit_m
                possible = np.abs(z) <= MAX_HEIGHT_M
                self._warn_of_heights(z[~possible].astype(np.float64))
                used = np.isfinite(x) & np.isfinite(y) & possible
                value = z if dimension is None else np.asarray(points[dimension])[chosen]
                yield np.column_stack([x, y])[used], value[used]

    def _warn_of_heights(self, impossible_m: Float[np.ndarray, " n"]) -> None:
        """Say once that points are left out, as cells of rasters are."""
        if len(impossible_m) and not self.warned:
            self.warned.append("heights")
            message = "%s: points with impossible heights (such as %g m) are left out; class them as noise"
            logger.warning(message, self.name, impossible_m[0])


@dataclass(frozen=True, kw_only=True)
class PlacedCloud:
    """Placement of a cloud: its CRS and the frame of the terrain, None for one in local metres; and its heights.

    middle: of the file, in its own coordinates; heights: their unit and datum.
    """

    crs: CRS | None
    frame: MapFrame | None
    middle: tuple[float, float]
    heights: HeightSystem

    def local_of(self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> Coordinates:
        """Return local metres of the file's coordinates."""
        if self.crs is None or self.frame is None:
            return x - self.middle[0], y - self.middle[1]
        if self.crs == self.frame.crs:
            return x - self.frame.origin_m[0], y - self.frame.origin_m[1]
        return self.frame.local_of(self.crs, x, y)


def _chosen(points: Any, choice: Choice) -> Bool[np.ndarray, " n"]:
    kind = np.asarray(points.classification)
    chosen = ~np.isin(kind, NOISE_CLASSES) & (np.asarray(points.withheld) == 0)
    if isinstance(choice, tuple):
        chosen &= np.isin(kind, choice)
    elif choice == "first":
        chosen &= np.asarray(points.return_number) <= 1
    elif choice == "ground":
        chosen &= kind == GROUND_CLASS
    return chosen


@contextmanager
def open_cloud(path: Path, key: str = KEY) -> Iterator[CloudFile]:
    """Open a LAS or LAZ file that a key of the scenario names.

    Raises InputFileError for any other file, and for one that is truncated or claims more points than it can hold.
    """
    with deferred(REQUESTS):
        import laspy

    size = regular_file(path, f"{key} =", REMEDY, MAX_BYTES)
    refuse_city_model(path, f"{key} =")
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
            raise InputFileError(f"{name}: has {points} points, too few for a surface; {REMEDY} with more")
        if points > MAX_POINTS or (not header.are_points_compressed and start + stored > size):
            message = f"{name}: claims {points:,} points, more than its {size:,} bytes can hold; get the whole file"
            raise InputFileError(message)
        if header.are_points_compressed:
            _check_chunks(path, start, size, points, name)
        if not (np.isfinite(low).all() and np.isfinite(high).all() and (low <= high).all()):
            raise InputFileError(f"{name}: its header has no valid bounds; write it anew, for example with PDAL")
        wkt = crs.to_wkt() if crs is not None else None
        yield CloudFile(reader=reader, name=name, points=points, low=low, high=high, crs_wkt=wkt)


def _check_records(path: Path, size: int, name: str) -> None:
    """Reject a header that claims more variable-length records than fit: the reader would allocate them all.

    Those of 54 bytes and more lie between the header and the points, the extended ones of LAS 1.4, of 60 and more,
    after them (ASPRS 2019, "LAS Specification 1.4 - R15", tables 3, 5 and 6).
    """
    with path.open("rb") as file:
        head = file.read(247).ljust(247, b"\0")
    header, points, records = struct.unpack_from("<HII", head, 94)
    extended_start, extended = struct.unpack_from("<QI", head, 235) if head[25] >= 4 else (0, 0)
    for count, record_bytes, room, kind in (
        (records, 54, min(points, size) - header, "variable-length records"),
        (extended, 60, size - extended_start, "extended variable-length records"),
    ):
        if head.startswith(b"LASF") and record_bytes * count > max(room, 0):
            message = f"{name}: its header claims {count:,} {kind}, more than its bytes can hold; get the whole file"
            raise InputFileError(message)


def _check_chunks(path: Path, start: int, size: int, points: int, name: str) -> None:
    """Reject a LAZ file with an invalid chunk table, for which the decompressor would exhaust memory.

    The compressed points begin with the offset of the table (-1: it is in the last 8 bytes of the file); the table
    begins with its version and the number of chunks, of at least one byte each (Isenburg 2013, "LASzip: lossless
    compression of LiDAR data").
    """
    with path.open("rb") as file:
        file.seek(min(start, size))
        table_start = int.from_bytes(file.read(8), "little", signed=True)
        if table_start == -1:
            file.seek(max(size - 8, 0))
            table_start = int.from_bytes(file.read(8), "little", signed=True)
        file.seek(table_start if 0 <= table_start <= size else size)
        head = file.read(8)
    chunks = int.from_bytes(head[4:8], "little")
    if not start < table_start <= size - 8 or len(head) < 8 or chunks > min(size, points):
        raise InputFileError(f"{name}: its table of compressed chunks is damaged; get the whole file")


@contextmanager
def _errors(name: str) -> Iterator[None]:
    """Convert errors of the LAS and LAZ readers to InputFileError."""
    try:
        yield
    except (RadarError, GeneratorExit, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # the decompressor's panics do not derive from Exception
        reason = reason_of(error)
        raise InputFileError(f"{name} cannot be read as a point cloud ({reason}); {REMEDY}") from None


def gridded(
    pieces: Callable[[], Iterator[Piece]], grid: Grid, statistic: Literal["mean", "max", "percentile"], fraction: float
) -> Raster:
    """Return a statistic of the heights of the points in each cell, NaN where there are none.

    pieces: yields all points in each call; a percentile needs several calls.
    grid: the cells.
    statistic: the mean, the highest, or the height that a share of the points of a cell does not exceed.
    fraction: for the percentile, from 0 to 1; found to within 1/4096 of a cell's range of heights.
    """
    if statistic == "mean":
        total, count = np.zeros(grid.rows * grid.columns), np.zeros(grid.rows * grid.columns)
        for cell, z in _in_cells(pieces(), grid):
            total += np.bincount(cell, z, minlength=len(total))
            count += np.bincount(cell, minlength=len(count))
        with np.errstate(invalid="ignore"):
            return _raster(grid, total / np.where(count > 0, count, np.nan))
    lowest, highest = np.full(grid.rows * grid.columns, np.inf), np.full(grid.rows * grid.columns, -np.inf)
    for cell, z in _in_cells(pieces(), grid):
        np.maximum.at(highest, cell, z)
        np.minimum.at(lowest, cell, z)
    highest[~np.isfinite(highest)] = np.nan
    if statistic == "max":
        return _raster(grid, highest)
    return _raster(grid, _percentile(pieces, grid, fraction, lowest, highest))


def majority(pieces: Iterator[Piece], grid: Grid, groups: Sequence[tuple[int, ...]]) -> Int[np.ndarray, "row column"]:
    """Return the most frequent group of the points' classes in each cell, by its number; -1 without a point of any.

    pieces: of classes; see `CloudFile.pieces`.
    """
    count = np.zeros((len(groups), grid.rows * grid.columns), dtype=np.int64)
    for cell, kind in _in_cells(pieces, grid):
        for own, group in zip(count, groups, strict=True):
            own += np.bincount(cell[np.isin(kind, group)], minlength=len(own))
    return np.where(count.any(axis=0), count.argmax(axis=0), -1).reshape(grid.shape)


def _percentile(
    pieces: Callable[[], Iterator[Piece]],
    grid: Grid,
    fraction: float,
    low: Float[np.ndarray, " cell"],
    high: Float[np.ndarray, " cell"],
) -> Float[np.ndarray, " cell"]:
    """Return a percentile of each cell by repeated refinement of its histogram."""
    low, width = np.where(np.isfinite(high), low, 0.0), np.where(np.isfinite(high), high - low, 0.0)
    rank: Float[np.ndarray, " cell"] | None = None
    for _ in range(NARROWINGS):
        count = np.zeros((len(low), PARTS), dtype=np.uint32)
        count_below = np.zeros(len(low))
        for cell, z in _in_cells(pieces(), grid):
            bin_index = np.floor((z - low[cell]) / np.where(width[cell] > 0, width[cell] / PARTS, 1.0)).astype(np.int64)
            # The highest point of a cell belongs to its last bin.

            bin_index = np.where(
                (bin_index == PARTS) & (z <= low[cell] + width[cell] * (1 + 1e-9)), PARTS - 1, bin_index
            )
            count_below += np.bincount(cell[bin_index < 0], minlength=len(low))
            in_range = (bin_index >= 0) & (bin_index < PARTS)
            np.add.at(count, (cell[in_range], bin_index[in_range]), 1)
        if rank is None:
            rank = fraction * np.maximum(count.sum(axis=1) - 1, 0)
        reached = count_below[:, None] + np.cumsum(count, axis=1) > rank[:, None]
        rank_bin = np.where(reached.any(axis=1), np.argmax(reached, axis=1), PARTS - 1)
        width = width / PARTS
        low = low + rank_bin * width
    return np.where(np.isfinite(high), low + width / 2, np.nan)


def _in_cells(pieces: Iterator[Piece], grid: Grid) -> Iterator[tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]]:
    """Yield the cells and the heights of the points within a grid."""
    west, east, south, north = grid.extent_m
    for place_m, z in pieces:
        x, y = place_m.T
        in_extent = (x >= west) & (x <= east) & (y >= south) & (y <= north)
        row, column, in_grid = grid.cell_of(place_m[in_extent])
        yield (row * grid.columns + column)[in_grid], z[in_extent][in_grid]


def _raster(grid: Grid, height_m: Float[np.ndarray, " cell"]) -> Raster:
    return Raster(grid=grid, height_m=height_m.reshape(grid.shape))
