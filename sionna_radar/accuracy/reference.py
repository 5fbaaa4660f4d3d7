"""Measured heights of a file that a DEM is held against: an elevation raster, a point cloud, or checkpoints."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio.transform import Affine
from rasterio.warp import Resampling, reproject

from sionna_radar.accuracy.illumination import Walls, raster_walls
from sionna_radar.elevation.file_heights import MAX_HEIGHT_M
from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.elevation.placed_raster import (
    apply_affine,
    cloud_height_system,
    height_system,
    horizontal_crs,
    vertical_datum,
)
from sionna_radar.elevation.placed_raster import reproject as convert
from sionna_radar.elevation.point_cloud import COVERS, Piece, gridded, majority, open_cloud
from sionna_radar.foundation.bounds import check_bounds
from sionna_radar.foundation.errors import InputFileError, reason_of
from sionna_radar.foundation.input_file import read_numbers, shown
from sionna_radar.foundation.raster import Grid, Raster, spans
from sionna_radar.foundation.raster_band import UNDECLARED_NODATA, band_values
from sionna_radar.foundation.raster_file import open_raster, require_cells

logger = logging.getLogger("sionna_radar")

KEY = "reference"
REMEDY = "give a GeoTIFF, a LAS or LAZ file, or a CSV file with the columns x, y, z and, if known, sigma"
# Largest shift of a DEM that is searched, m.
SEARCHED_M = 20.0
# Fewest checkpoints from which an offset is estimated.
OFFSET_CHECKPOINTS = 3
# Least fraction of cells with points at which a cloud counts as a surface.
MIN_FILLED_FRACTION = 0.5


@dataclass(frozen=True, kw_only=True)
class ReferenceSurface:
    """Measured heights on cells of their own.

    height_m: heights over the local origin, rows from north to south; transform: from columns and rows to `crs`.
    sigma_m: their standard deviation; 0 if unknown.
    cover: number of each cell in `COVERS`, NaN for none; None if it is not known.
    """

    kind: Literal["raster", "cloud"]
    height_m: Float[np.ndarray, "row column"]
    transform: Affine
    crs: str
    sigma_m: float
    cover: Float[np.ndarray, "row column"] | None = None

    @classmethod
    def of(cls, raster: Raster) -> "ReferenceSurface":
        """Return a raster as a surface, its own standard deviation unknown."""
        transform, crs = Affine(*raster.grid.transform), _crs_of(raster.grid)
        return cls(kind="raster", height_m=raster.height_m[::-1], transform=transform, crs=crs, sigma_m=0.0)

    def on(self, grid: Grid, shift_m: tuple[float, float] = (0.0, 0.0), of: np.ndarray | None = None) -> Raster:
        """Return the heights on a grid, moved by a horizontal shift, or other values of the cells.

        Heights are bilinear, NaN next to empty cells and beyond the middles of the outermost; of cells smaller than the
        grid's they are means, NaN where less than half of these have a height. Other values are those of the nearest
        cell.
        """
        if of is not None:
            return self._warped(grid, shift_m, of, Resampling.nearest)
        raster = self._warped(grid, shift_m, self.height_m, Resampling.bilinear)
        # GDAL leaves empty cells, and those beyond the edge, out of a mean, whose middle is then elsewhere.
        filled = np.pad(np.isfinite(self.height_m).astype(float), 1)
        weight = self._warped(grid, shift_m, filled, Resampling.bilinear, margin=1).height_m
        rounding = 1e-6
        is_finer = self._spacing_m(grid) < grid.spacing_m * (1 - rounding)
        return raster.within(weight >= (0.5 if is_finer else 1 - rounding))

    def _warped(
        self, grid: Grid, shift_m: tuple[float, float], values: np.ndarray, resampling: Resampling, margin: int = 0
    ) -> Raster:
        """Return values of the cells, and of a margin around them, on a grid."""
        a, b, c, d, e, f = grid.transform
        out = np.full(grid.shape, np.nan)
        reproject(
            values,
            out,
            src_transform=Affine(*self.transform[:6]) @ Affine.translation(-margin, -margin),
            src_crs=self.crs,
            dst_transform=Affine(a, b, c - shift_m[0], d, e, f - shift_m[1]),
            dst_crs=_crs_of(grid),
            src_nodata=np.nan,
            dst_nodata=np.nan,
            resampling=resampling,
        )
        return Raster(grid=grid, height_m=out[::-1])

    def _spacing_m(self, grid: Grid) -> float:
        """Return the size of its own cells on the map of a grid."""
        west, south, east, north = _extent_on(grid, self)
        return float(np.sqrt((east - west) * (north - south) / self.height_m.size))

    def own_cells(self, grid: Grid) -> Grid:
        """Return cells over a grid that are as large as its own, if those are larger."""
        spacing_m = max(grid.spacing_m, self._spacing_m(grid))
        west, east, south, north = grid.extent_m
        return replace(Grid.covering(west, south, east, north, spacing_m), georeference=grid.georeference)

    def covers(self, grid: Grid, shift_m: tuple[float, float]) -> dict[str, Bool[np.ndarray, "row column"]]:
        """Return the cells of each cover on a grid, moved by a horizontal shift; empty if none is known."""
        if self.cover is None:
            return {}
        number = self.on(grid, shift_m, self.cover).height_m
        return {
            name: number == class_number for class_number, name in enumerate(COVERS) if np.any(number == class_number)
        }

    def walls(self, grid: Grid, shift_m: tuple[float, float]) -> Walls:
        """Return the walls within a grid, moved by a horizontal shift: steps between the reference's own cells."""
        corner_m = np.array(list(product(*np.reshape(grid.extent_m, (2, 2))))) + _origin_m(grid)[:2] - shift_m
        reference_crs, theirs = CRS.from_wkt(self.crs), CRS.from_wkt(_crs_of(grid))
        at = np.floor(apply_affine(~self.transform, *convert(theirs, reference_crs, *corner_m.T)))
        (left, top), (right, bottom) = np.maximum([at.min(axis=1) - 1, at.max(axis=1) + 2], 0).astype(int)

        def place(row: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
            on_map = convert(reference_crs, theirs, *apply_affine(self.transform, column + left + 0.5, row + top + 0.5))
            return np.column_stack(on_map) - _origin_m(grid)[:2] + shift_m

        return raster_walls(self.height_m[top:bottom, left:right], place)


@dataclass(frozen=True, kw_only=True)
class Checkpoints:
    """Measured heights of single places, in local metres: of a table, or of a cloud too sparse for a surface.

    sigma_m: standard deviation of each height; 0 if unknown.
    """

    place_m: Float[np.ndarray, "n 2"]
    height_m: Float[np.ndarray, " n"]
    sigma_m: Float[np.ndarray, " n"]
    kind: Literal["checkpoints", "sparse cloud"] = "checkpoints"


def widened(grid: Grid, cells: int) -> Grid:
    """Return a grid with so many cells more to each side."""
    return replace(
        grid,
        west_m=grid.west_m - cells * grid.spacing_m,
        south_m=grid.south_m - cells * grid.spacing_m,
        columns=grid.columns + 2 * cells,
        rows=grid.rows + 2 * cells,
    )


def read_reference(path: Path, grid: Grid, sigma_m: float = 0.0) -> ReferenceSurface | Checkpoints:
    """Return the measured heights of a file, on and around a grid; see `compare_with_reference`."""
    check_bounds([("reference-sigma", sigma_m, 0.0, 1e4)])
    read = {".las": _read_cloud, ".laz": _read_cloud, ".csv": _read_checkpoints, ".txt": _read_checkpoints}
    reference = read.get(path.suffix.lower(), _read_raster)(path, grid, sigma_m)
    if isinstance(reference, Checkpoints):
        inside = int(grid.cell_of(reference.place_m)[2].sum())
        if inside < OFFSET_CHECKPOINTS:
            raise InputFileError(
                f"{KEY} = {shown(path)}: {inside} of {len(reference.place_m)} places lie within the DEM, "
                f"{spans(_map_extent(grid))}; give at least {OFFSET_CHECKPOINTS}, x and y in its coordinates"
            )
    elif not reference.on(grid).filled.any():
        covered = spans(_extent_on(grid, reference))
        message = f"has no height within the DEM: it covers {covered}, and the DEM {spans(_map_extent(grid))}"
        raise InputFileError(f"{KEY} = {shown(path)}: {message}; give a reference that covers it")
    return reference


def _map_extent(grid: Grid) -> tuple[float, float, float, float]:
    """Return west, south, east and north of a grid in the coordinates of its map."""
    west, east, south, north = grid.extent_m
    x, y, _ = _origin_m(grid)
    return west + x, south + y, east + x, north + y


def _extent_on(grid: Grid, reference: "ReferenceSurface") -> tuple[float, float, float, float]:
    """Return west, south, east and north of measured heights in the coordinates of a grid's map."""
    rows, columns = reference.height_m.shape
    corner = np.array([*product((0.0, float(columns)), (0.0, float(rows)))])
    reference_crs, theirs = CRS.from_wkt(reference.crs), CRS.from_wkt(_crs_of(grid))
    x, y = convert(reference_crs, theirs, *apply_affine(reference.transform, *corner.T))
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def _read_raster(path: Path, grid: Grid, sigma_m: float) -> ReferenceSurface:
    named = f"{KEY} = {shown(path)}"
    with open_raster(path, KEY) as file:
        require_cells(file, named, "heights")
        crs = _same_kind_of_crs(file.crs.to_wkt() if file.crs else None, grid, named)
        unit_m = height_system(file.units[0], CRS.from_wkt(crs), None, None).unit_m
        height = band_values(file, file.read(1, masked=True)) * unit_m
        height[np.abs(height) > MAX_HEIGHT_M] = np.nan
        return ReferenceSurface(
            kind="raster",
            height_m=height - _base_m(grid),
            transform=file.transform,
            crs=horizontal_crs(CRS.from_wkt(crs)).to_wkt(),
            sigma_m=sigma_m,
        )


def _read_cloud(path: Path, grid: Grid, sigma_m: float) -> ReferenceSurface | Checkpoints:
    """Return the mean heights of the first returns in the cells of a grid, with a margin for the shift.

    Where fewer than half of the cells within the cloud's bounds have a point, its points are checkpoints.
    """
    wide = widened(grid, int(np.ceil(SEARCHED_M / grid.spacing_m)))
    with open_cloud(path, KEY) as cloud:
        crs = CRS.from_wkt(_same_kind_of_crs(cloud.crs_wkt, grid, cloud.name))
        east_m, north_m = _origin_m(grid)[:2]
        frame = MapFrame(crs=horizontal_crs(CRS.from_wkt(_crs_of(grid))), origin_m=(east_m, north_m))
        vertical = cloud_height_system(crs, key=KEY).unit_m

        def local_of(
            x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
        ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
            return frame.local_of(horizontal_crs(crs), x, y)

        def pieces(dimension: str | None = None) -> Iterator[Piece]:
            return cloud.pieces("first", local_of, vertical, dimension)

        (west, south), (east, north) = np.reshape(cloud.extent_m(local_of), (2, 2))
        ours_west, ours_east, ours_south, ours_north = wide.extent_m
        if not (west < ours_east and east > ours_west and south < ours_north and north > ours_south):
            covered = spans((west + east_m, south + north_m, east + east_m, north + north_m))
            message = f"covers {covered}, and the DEM {spans(_map_extent(grid))}; give a reference that covers it"
            raise InputFileError(f"{cloud.name}: has no height within the DEM: it {message}")
        raster = gridded(pieces, wide, "mean", 0.5)
        cells = np.argwhere(raster.filled)
        if len(cells) < MIN_FILLED_FRACTION * np.prod(np.ptp(cells, axis=0) + 1 if len(cells) else 1):
            place_m, height_m = (np.concatenate(part) for part in zip(*pieces(), strict=True))
            own_m = np.full(len(height_m), sigma_m)
            height_m = height_m - _base_m(grid)
            return Checkpoints(place_m=place_m, height_m=height_m, sigma_m=own_m, kind="sparse cloud")
        cover = majority(pieces("classification"), wide, tuple(COVERS.values()))[::-1]
    return ReferenceSurface(
        kind="cloud",
        height_m=raster.height_m[::-1] - _base_m(grid),
        transform=Affine(*wide.transform),
        crs=_crs_of(grid),
        sigma_m=sigma_m,
        cover=np.where(cover < 0, np.nan, cover),
    )


def _read_checkpoints(path: Path, grid: Grid, sigma_m: float) -> Checkpoints:
    columns = {"x": None, "y": None, "z": None, "sigma": sigma_m}
    lines, table = read_numbers(path, f"{KEY} =", columns, REMEDY, further="ignored")
    rows = np.column_stack(table)
    if (negative := np.flatnonzero(rows[:, 3] < 0)).size:
        raise InputFileError(f"{KEY} = {shown(path)}: line {lines[negative[0]]} has a negative sigma; give 0 or more")
    if (empty := np.flatnonzero((rows[:, 2] == UNDECLARED_NODATA) | (np.abs(rows[:, 2]) > MAX_HEIGHT_M))).size:
        raise InputFileError(
            f"{KEY} = {shown(path)}: line {lines[empty[0]]} has z = {rows[empty[0], 2]:g}, not a height on Earth "
            f"({len(empty)} of {len(rows)} lines); leave such lines out"
        )
    position_m = rows[:, :3] - np.array(_origin_m(grid))
    return Checkpoints(place_m=position_m[:, :2], height_m=position_m[:, 2], sigma_m=rows[:, 3])


# Local metres have no CRS; rasterio asks for one, and the same for both leaves coordinates as they are.
LOCAL = CRS.from_epsg(3857).to_wkt()


def _crs_of(grid: Grid) -> str:
    place = grid.georeference
    return LOCAL if place is None else horizontal_crs(CRS.from_wkt(place.crs_wkt)).to_wkt()


def _origin_m(grid: Grid) -> tuple[float, float, float]:
    return (0.0, 0.0, 0.0) if grid.georeference is None else grid.georeference.origin_m


def _base_m(grid: Grid) -> float:
    return _origin_m(grid)[2]


def _same_kind_of_crs(wkt: str | None, grid: Grid, named: str) -> str:
    """Return the CRS of a file; InputFileError if only one of file and DEM has one."""
    if wkt is None and grid.georeference is not None:
        raise InputFileError(f"{named}: has no CRS, and the DEM has one; add it with gdal_translate -a_srs, or las2las")
    if wkt is not None and grid.georeference is None:
        message = f"{named}: has a CRS, and the DEM is in local metres; give a file in the same metres without a CRS"
        raise InputFileError(message)
    if wkt is None or grid.georeference is None:
        return LOCAL
    try:
        crs = CRS.from_wkt(wkt)
    except CRSError as error:
        raise InputFileError(f"{named}: its CRS cannot be used ({reason_of(error)}); {REMEDY}") from error
    dem_datum, other = vertical_datum(CRS.from_wkt(grid.georeference.crs_wkt)), vertical_datum(crs)
    if dem_datum and other and dem_datum != other:
        warning = "%s: heights count from %s, and those of the DEM from %s; convert them, or take the shift out"
        logger.warning(warning, named, other, dem_datum)
    return crs.to_wkt()
