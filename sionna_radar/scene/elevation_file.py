"""Elevation files of any projection, cut out and brought into the local metric frame.

A file is kept in its own projection where that is true to the ground (metres, unit scale, north up), and
brought into the UTM zone of its middle otherwise. The target cells are looked up in the file one by one
(bilinear between its cell centres, after averaging where the file is finer), not warped by GDAL, whose
approximate transformer and half-cell extrapolation at edges and holes would cost accuracy.
"""

import logging
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from jaxtyping import Float, Shaped
from pyproj import CRS, Geod, Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.database import query_utm_crs_info
from pyproj.exceptions import ProjError
from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
from rasterio.io import MemoryFile
from rasterio.windows import Window
from scipy.ndimage import map_coordinates

from sionna_radar.errors import InputFileError, Problem, RadarError, ScenarioError
from sionna_radar.raster import Georeference, Grid, Raster

logger = logging.getLogger("sionna_radar")

MAX_CELLS = 4_000_000
# Beyond any height on Earth: a stand-in for "no data" that the file does not declare.
MAX_HEIGHT_M = 12_000.0
# -9999 lies within that limit, yet no land is there.
UNDECLARED_NODATA = -9999.0
# A projection is kept as the local frame while a metre is a metre, and north is up, to this much.
MAX_SCALE_ERROR = 0.01
MAX_CONVERGENCE_DEG = 10.0
FEET_M = {"ft": 0.3048, "foot": 0.3048, "feet": 0.3048, "us survey foot": 1200 / 3937, "ftus": 1200 / 3937}


@dataclass(frozen=True, kw_only=True)
class Cutout:
    """What is wanted of a file: the window in local metres (west, south, east, north) and the frame."""

    window_m: tuple[float, float, float, float]
    crs: str | None = None
    centre_lonlat_deg: tuple[float, float] | None = None
    spacing_m: float | None = None


@dataclass(frozen=True, kw_only=True)
class _Source:
    """An open file and how its cells lie in the local frame: CRS `local` less the origin (x, y).

    height_unit_m: metres in one unit of the file's heights.
    """

    dataset: Any
    crs: CRS
    local: CRS
    origin: tuple[float, float]
    height_unit_m: float

    @property
    def is_reprojected(self) -> bool:
        """Whether the local frame is another projection than the file's."""
        return self.local is not self.crs

    def local_of(
        self, column: Float[np.ndarray, " n"], row: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Local metres of pixel coordinates, whose whole numbers are cell centres."""
        x, y = _apply(self.dataset.transform, column + 0.5, row + 0.5)
        if self.is_reprojected:
            x, y = _transform(self.crs, self.local, x, y)
        return x - self.origin[0], y - self.origin[1]

    def pixel_of(
        self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Pixel coordinates (column, row) of local metres; far outside the projection not finite."""
        x, y = x + self.origin[0], y + self.origin[1]
        if self.is_reprojected:
            x, y = _transform(self.local, self.crs, x, y)
        if self.crs.is_geographic:
            # The file may count its longitudes 0..360, or span the date line.
            turn = 2 * math.pi / self.crs.axis_info[0].unit_conversion_factor
            middle = _middle(self.dataset)[0]
            x = middle + (x - middle + turn / 2) % turn - turn / 2
        column, row = _apply(~self.dataset.transform, x, y)
        return column - 0.5, row - 0.5

    @property
    def steps_m(self) -> tuple[float, float]:
        """Distance between neighbouring columns and between neighbouring rows, next to the local origin."""
        limits = [n - 1 for n in reversed(self.dataset.shape)]
        place = self.pixel_of(np.zeros(1), np.zeros(1))
        column, row = (float(np.clip(np.nan_to_num(c[0]), 0, n)) for c, n in zip(place, limits, strict=True))
        x, y = self.local_of(np.array([column, column + 1, column]), np.array([row, row, row + 1]))
        return math.hypot(x[1] - x[0], y[1] - y[0]), math.hypot(x[2] - x[0], y[2] - y[0])


def read_file(path: Path, cutout: Cutout) -> tuple[Raster, Georeference]:
    """Return the heights of a raster file (its first band) within the window, and the frame's place.

    Raises InputFileError for a file that cannot be read or holds no elevation, ScenarioError for a frame
    or window that does not suit it.
    """
    if not path.is_file():
        what = "is a directory" if path.is_dir() else "does not exist"
        message = f"terrain.path = {path} {what}; give the path of an elevation file (GeoTIFF, .asc, .hgt)"
        raise InputFileError(message)
    with _gdal_errors_as_input_errors(path), rasterio.open(path) as dataset:
        _check_content(dataset, path)
        return _cut(dataset, cutout)


def read_array(
    height_m: Shaped[np.ndarray, "row column"],
    transform: rasterio.Affine,
    cutout: Cutout,
) -> tuple[Raster, Georeference]:
    """Return the heights of an array, placed like a raster file by its transform and `cutout.crs`."""
    rows, columns = height_m.shape
    profile = {"driver": "GTiff", "count": 1, "dtype": height_m.dtype, "height": rows, "width": columns}
    with MemoryFile() as memory:
        with memory.open(**profile, transform=transform) as writable:
            writable.write(height_m, 1)
        with memory.open() as dataset:
            return _cut(dataset, cutout)


@contextmanager
def _gdal_errors_as_input_errors(path: Path) -> Iterator[None]:
    """Turn what GDAL and PROJ raise about a file into one message; let our own errors pass."""
    try:
        with warnings.catch_warnings():
            # Said as an error below, with the remedy.
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            yield
    except RadarError:
        raise
    except (RasterioError, CRSError, ProjError, OSError) as error:
        reason = str(error.__cause__ or error).splitlines()[0]
        message = (
            f"terrain.path = {path} cannot be read as an elevation raster ({reason}); "
            "give a complete GeoTIFF, Esri ASCII grid or .hgt, or convert it with gdal_translate"
        )
        raise InputFileError(message) from error


def _check_content(dataset: Any, path: Path) -> None:
    problem = None
    if dataset.count == 0:
        problem = "holds no band, perhaps subdatasets; extract one with gdal_translate"
    elif np.dtype(dataset.dtypes[0]).kind not in "iuf":
        problem = f"holds {dataset.dtypes[0]} values, not heights; give an elevation raster"
    elif min(dataset.shape) < 2:
        problem = f"has {dataset.height} x {dataset.width} cells, too few for a surface; give at least 2 x 2"
    elif dataset.transform.is_identity:
        problem = "does not say where on the Earth it lies; georeference it with gdal_translate or gdalwarp"
    elif dataset.transform.is_degenerate:
        problem = "has cells of no size; repair its geotransform with gdal_translate -a_ullr"
    if problem:
        message = f"terrain.path = {path} {problem}"
        raise InputFileError(message)


# ------------------------------------------------------------------------------------- frame


def _cut(dataset: Any, cutout: Cutout) -> tuple[Raster, Georeference]:
    source = _place(dataset, cutout)
    grid = _grid_of(source, cutout)
    height_m = _heights_on(source, grid)
    corners = np.isfinite(height_m)
    if not (corners[:-1, :-1] & corners[:-1, 1:] & corners[1:, :-1] & corners[1:, 1:]).any():
        raise _outside(source, cutout, f"no 2 x 2 cells of {grid.spacing_m:g} m there have heights")
    raster = _without_empty_border(Raster(grid=grid, height_m=height_m))
    base_m = math.floor(np.nanmin(raster.height_m))
    georeference = Georeference(crs_wkt=source.local.to_wkt(), origin_m=(*source.origin, float(base_m)))
    return Raster(grid=raster.grid, height_m=raster.height_m - base_m), georeference


def _place(dataset: Any, cutout: Cutout) -> _Source:
    """Return the file with its local frame: own projection or UTM zone, about the centre."""
    whole = _crs_of(dataset, cutout)
    crs = _horizontal(whole)
    if not (crs.is_projected or crs.is_geographic):
        message = f"{crs.name!r} is neither projected nor geographic; give one that is, as 'EPSG:32631'"
        raise ScenarioError([Problem("terrain.crs", message)])
    lon, lat = _centre_lonlat(dataset, crs, cutout)
    local = crs if _is_true_to_the_ground(dataset, crs, lon, lat) else _metric_crs(lon, lat)
    if cutout.centre_lonlat_deg is None and local is crs:
        x, y = _middle(dataset)
    else:
        x, y = (float(c[0]) for c in _transform(CRS(4326), local, np.array([lon]), np.array([lat])))
    unit_m = _height_unit_m(dataset, whole)
    return _Source(dataset=dataset, crs=crs, local=local, origin=(x, y), height_unit_m=unit_m)


def _crs_of(dataset: Any, cutout: Cutout) -> CRS:
    """Return the scenario's CRS, or else the file's own."""
    if cutout.crs is not None:
        try:
            return CRS.from_user_input(cutout.crs)
        except ProjError as error:
            message = f"{cutout.crs!r} is no coordinate reference system; give one such as 'EPSG:32631'"
            raise ScenarioError([Problem("terrain.crs", message)]) from error
    if dataset.crs is None or not dataset.crs.to_wkt():
        message = "missing, and the file names none; give the file's own system, such as 'EPSG:32631'"
        raise ScenarioError([Problem("terrain.crs", message)])
    return CRS.from_wkt(dataset.crs.to_wkt())


def _horizontal(crs: CRS) -> CRS:
    """Return the part of a CRS that places points on the map."""
    while crs.is_compound:
        crs = crs.sub_crs_list[0]
    return crs.to_2d() if len(crs.axis_info) == 3 and not crs.is_geocentric else crs


def _centre_lonlat(dataset: Any, crs: CRS, cutout: Cutout) -> tuple[float, float]:
    if cutout.centre_lonlat_deg is not None:
        lon, lat = cutout.centre_lonlat_deg
        if not (-180 <= lon <= 360 and -90 <= lat <= 90):
            message = f"({lon:g}, {lat:g}) is no longitude and latitude in degrees; give them in this order"
            raise ScenarioError([Problem("terrain.centre_lonlat_deg", message)])
        return lon, lat
    x, y = _middle(dataset)
    lons, lats = _transform(crs, CRS(4326), np.array([x]), np.array([y]))
    lon, lat = float(lons[0]), float(lats[0])
    latitude_too_far = crs.is_geographic and abs(y) * crs.axis_info[0].unit_conversion_factor > math.pi / 2
    if not (math.isfinite(lon) and math.isfinite(lat)) or latitude_too_far:
        message = f"{crs.name!r} has no place for the raster's middle ({x:g}, {y:g}); give the file's system"
        raise ScenarioError([Problem("terrain.crs", message)])
    return lon, lat


def _is_true_to_the_ground(dataset: Any, crs: CRS, lon: float, lat: float) -> bool:
    """Whether the file's map metres are metres with north up, as those of Web Mercator are not."""
    transform = dataset.transform
    is_metric = crs.is_projected and all(axis.unit_conversion_factor == 1 for axis in crs.axis_info)
    if not is_metric or transform.b != 0 or transform.d != 0:
        return False
    step = 100.0
    x, y = _transform(CRS(4326), crs, np.array([lon]), np.array([lat]))
    lons, lats = _transform(crs, CRS(4326), x + step * np.array([0, 1, 0]), y + step * np.array([0, 0, 1]))
    if not np.isfinite([lons, lats]).all():
        return False
    azimuth, _, distance = Geod(ellps="WGS84").inv(lons[[0, 0]], lats[[0, 0]], lons[1:], lats[1:])
    scale_error = np.abs(np.asarray(distance) / step - 1).max()
    return bool(scale_error <= MAX_SCALE_ERROR and abs(azimuth[1]) <= MAX_CONVERGENCE_DEG)


def _metric_crs(lon: float, lat: float) -> CRS:
    """Return the UTM zone of a place; near a pole, where there is none, a transverse Mercator of its own."""
    lon = (lon + 180) % 360 - 180
    place = AreaOfInterest(lon, lat, lon, lat)
    zones = query_utm_crs_info(datum_name="WGS 84", area_of_interest=place) if -80 <= lat <= 84 else []
    if zones:
        return CRS.from_authority(zones[0].auth_name, zones[0].code)
    return CRS.from_dict({"proj": "tmerc", "lat_0": lat, "lon_0": lon, "datum": "WGS84", "units": "m"})


def _height_unit_m(dataset: Any, crs: CRS) -> float:
    """Return the metres of one height unit: by a vertical CRS, else by the band's unit, else one.

    Depths, which count downwards, have a negative unit.
    """
    if crs.is_compound or (len(crs.axis_info) == 3 and not crs.is_geocentric):
        axis = crs.axis_info[2]
        return axis.unit_conversion_factor * (-1 if axis.direction == "down" else 1)
    band_unit = (dataset.units[0] or "").lower()
    if band_unit in FEET_M:
        return FEET_M[band_unit]
    if crs.is_projected and crs.axis_info[0].unit_conversion_factor != 1 and not band_unit:
        logger.warning(
            "terrain: the map counts in %s but no unit is given for heights; they are taken as metres",
            crs.axis_info[0].unit_name,
        )
    return 1.0


# -------------------------------------------------------------------------------------- grid


def _grid_of(source: _Source, cutout: Cutout) -> Grid:
    """Return the cells that cover the part of the window within the file, at most MAX_CELLS.

    In the file's own projection the cells are aligned with the file's.
    """
    west, south, east, north = _overlap_m(source, cutout)
    spacing = wanted = cutout.spacing_m or float(f"{min(source.steps_m):.12g}")
    if spacing > min(east - west, north - south):
        message = f"{spacing:g} exceeds the terrain in sight, {east - west:g} x {north - south:g} m; lower it"
        raise ScenarioError([Problem("terrain.spacing_m", message)])
    anchor = (0.0, 0.0)
    if not source.is_reprojected:
        x, y = source.local_of(np.zeros(1), np.zeros(1))
        anchor = float(x[0]), float(y[0])
    # The small number keeps a boundary that is a cell centre from being rounded past it.
    while True:
        first = [math.floor((low - a) / spacing + 1e-6) for low, a in zip((west, south), anchor, strict=True)]
        last = [math.ceil((high - a) / spacing - 1e-6) for high, a in zip((east, north), anchor, strict=True)]
        columns, rows = (b - a + 1 for a, b in zip(first, last, strict=True))
        if columns * rows <= MAX_CELLS:
            break
        spacing *= math.ceil(100 * math.sqrt(columns * rows / MAX_CELLS)) / 100
    if spacing != wanted:
        logger.warning(
            "terrain: the part in sight has more than %s cells of %g m; coarsened to %g m. "
            "Shorten the flight or raise terrain.spacing_m",
            f"{MAX_CELLS:,}",
            wanted,
            spacing,
        )
    origin = [a + k * spacing for a, k in zip(anchor, first, strict=True)]
    return Grid(west_m=origin[0], south_m=origin[1], spacing_m=spacing, columns=columns, rows=rows)


def _overlap_m(source: _Source, cutout: Cutout) -> tuple[float, float, float, float]:
    """Return the rectangle in local metres that the window and the file's cell centres share."""
    low, high = np.zeros(2), np.array(source.dataset.shape[::-1]) - 1.0
    seen = np.array(source.pixel_of(*_outline(cutout.window_m)))
    # A window that reaches beyond the projection is not bounded by its outline.
    if np.isfinite(seen).all():
        # Two cells of margin: an outline sampled at points may cut a curved edge short.
        low = np.maximum(low, np.floor(seen.min(axis=1)) - 2)
        high = np.minimum(high, np.ceil(seen.max(axis=1)) + 2)
    if (low < high).all():
        west, south, east, north = _extent_m(source, (*low.tolist(), *high.tolist()))
        # One cell beyond the window, so that it lies between cell centres.
        step = max(source.steps_m)
        west, south = max(west, cutout.window_m[0] - step), max(south, cutout.window_m[1] - step)
        east, north = min(east, cutout.window_m[2] + step), min(north, cutout.window_m[3] + step)
        if west < east and south < north:
            return west, south, east, north
    raise _outside(source, cutout, "the terrain file does not reach there")


def _extent_m(
    source: _Source, pixels: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    """Return the rectangle around a box of pixels (columns and rows), as far as it has a place."""
    x, y = source.local_of(*_outline(pixels))
    placed = np.isfinite(x) & np.isfinite(y)
    if not placed.any():
        return math.inf, math.inf, -math.inf, -math.inf
    x, y = x[placed], y[placed]
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def _outside(source: _Source, cutout: Cutout, what: str) -> ScenarioError:
    """Return the error of a window without terrain, on the field that put it there."""
    in_metres = "x = {0:.0f} to {2:.0f} m, y = {1:.0f} to {3:.0f} m"
    rows, columns = source.dataset.shape
    extent = in_metres.format(*_extent_m(source, (0.0, 0.0, columns - 1.0, rows - 1.0)))
    message = f"the flight sees {in_metres.format(*cutout.window_m)}, but {what}: the file covers {extent}"
    if cutout.centre_lonlat_deg is None:
        problem = Problem("terrain", f"{message}; move the flight or set terrain.centre_lonlat_deg")
    else:
        lon, lat = cutout.centre_lonlat_deg
        problem = Problem("terrain.centre_lonlat_deg", f"about ({lon:g}, {lat:g}) {message}; move the centre")
    return ScenarioError([problem])


# ----------------------------------------------------------------------------------- heights


def _heights_on(source: _Source, grid: Grid) -> Float[np.ndarray, "row column"]:
    """Return bilinear heights at the grid's centres; NaN beside a cell without data."""
    column, row = source.pixel_of(*grid.centres_m.T)
    # Rounding errors must not turn a look-up at a cell centre into one between two cells.
    column, row = (np.where(np.abs(c - np.rint(c)) < 1e-6, np.rint(c), c) for c in (column, row))
    rows, columns = source.dataset.shape
    inside = (column >= 0) & (column <= columns - 1) & (row >= 0) & (row <= rows - 1)
    height_m = np.full(grid.columns * grid.rows, np.nan)
    if inside.any():
        lookup = row[inside], column[inside]
        # How many whole cells of the file one target cell holds: as many are averaged.
        factor = [
            max(1, math.floor(min(n, grid.spacing_m / step + 1e-6)))
            for n, step in zip((rows, columns), reversed(source.steps_m), strict=True)
        ]
        row_slice, column_slice = (
            _span_of(c, f, n) for c, f, n in zip(lookup, factor, (rows, columns), strict=True)
        )
        cells = _averaged(source, (row_slice, column_slice), (factor[0], factor[1]))
        # Block k holds the cells k f ... k f + f - 1, so its centre is (f - 1) / 2 cells on.
        in_blocks = [
            (c - w.start - (f - 1) / 2) / f
            for c, w, f in zip(lookup, (row_slice, column_slice), factor, strict=True)
        ]
        height_m[inside] = _bilinear(cells, in_blocks[0], in_blocks[1])
    return height_m.reshape(grid.shape)


def _span_of(coordinate: Float[np.ndarray, " n"], factor: int, cells: int) -> slice:
    """Return the cells around the coordinates, from a block's first one, with a block to spare."""
    first = max(0, (int(coordinate.min()) // factor - 1) * factor)
    return slice(first, min(cells, (int(coordinate.max()) // factor + 2) * factor))


def _averaged(
    source: _Source, window: tuple[slice, slice], factor: tuple[int, int]
) -> Float[np.ndarray, "row column"]:
    """Return block means of a window of the file, read strip by strip so that no file is too large.

    A block is empty where less than half of it has data. Cells beyond the last whole block are dropped.
    """
    rows, columns = ((w.stop - w.start) // f for w, f in zip(window, factor, strict=True))
    means = np.full((rows, columns), np.nan)
    strip = max(1, MAX_CELLS // (max(1, columns) * factor[0] * factor[1]))
    for first in range(0, rows, strip):
        count = min(strip, rows - first)
        height_m = _read(
            source,
            Window(
                window[1].start, window[0].start + first * factor[0], columns * factor[1], count * factor[0]
            ),
        )
        blocks = height_m.reshape(count, factor[0], columns, factor[1])
        filled = np.isfinite(blocks)
        n = filled.sum(axis=(1, 3))
        total = np.where(filled, blocks, 0).sum(axis=(1, 3))
        enough = 2 * n >= factor[0] * factor[1]
        means[first : first + count][enough] = total[enough] / n[enough]
    return means


def _read(source: _Source, window: Window) -> Float[np.ndarray, "row column"]:
    """Return heights of the file in metres, NaN where it has none, declared or not."""
    dataset = source.dataset
    stored = dataset.read(1, window=window, masked=True)
    undeclared = stored.data == UNDECLARED_NODATA
    height_m: Float[np.ndarray, "row column"] = stored.astype(np.float64).filled(np.nan)
    height_m = np.asarray((height_m * dataset.scales[0] + dataset.offsets[0]) * source.height_unit_m)
    with np.errstate(invalid="ignore"):
        undeclared |= np.abs(height_m) > MAX_HEIGHT_M
    undeclared &= ~np.ma.getmaskarray(stored)
    if undeclared.any():
        logger.warning(
            "terrain: %d cells hold no possible height (such as %g) and are taken as empty; "
            "declare the file's nodata value with gdal_edit -a_nodata",
            undeclared.sum(),
            stored.data[undeclared][0],
        )
        height_m[undeclared] = np.nan
    return height_m


def _bilinear(
    cells: Float[np.ndarray, "row column"], row: Float[np.ndarray, " n"], column: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return heights between cells, NaN outside them or where an empty one has any weight."""
    filled = np.isfinite(cells)
    height_m = map_coordinates(np.where(filled, cells, 0), [row, column], order=1, cval=np.nan)
    weight = map_coordinates(filled.astype(np.float64), [row, column], order=1, cval=0.0)
    return np.asarray(np.where(weight > 1 - 1e-9, height_m, np.nan))


def _without_empty_border(raster: Raster) -> Raster:
    """Return the raster less the outer rows and columns in which every cell is empty."""
    filled = np.argwhere(raster.filled)
    (first_row, first_column), (last_row, last_column) = filled.min(axis=0), filled.max(axis=0)
    grid = raster.grid
    cropped = Grid(
        west_m=grid.west_m + int(first_column) * grid.spacing_m,
        south_m=grid.south_m + int(first_row) * grid.spacing_m,
        spacing_m=grid.spacing_m,
        columns=int(last_column - first_column) + 1,
        rows=int(last_row - first_row) + 1,
    )
    height_m = raster.height_m[first_row : last_row + 1, first_column : last_column + 1]
    return Raster(grid=cropped, height_m=height_m)


# ------------------------------------------------------------------------------- coordinates


def _apply(
    transform: rasterio.Affine, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Apply an affine transform to points (affine 3 warns of its `*`, affine 2 has no `@`)."""
    a, b, c, d, e, f = tuple(transform)[:6]
    return a * x + b * y + c, d * x + e * y + f


def _transform(
    source: CRS, target: CRS, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Transform points between projections, easting or longitude first; infinite where it has no place."""
    x, y = Transformer.from_crs(source, target, always_xy=True).transform(x, y)
    return np.asarray(x), np.asarray(y)


def _middle(dataset: Any) -> tuple[float, float]:
    """Return the middle of the raster in its own CRS."""
    rows, columns = dataset.shape
    x, y = _apply(dataset.transform, np.array([columns / 2]), np.array([rows / 2]))
    return float(x[0]), float(y[0])


def _outline(box: tuple[float, float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return points along the edges of a rectangle (low x, low y, high x, high y)."""
    low_x, low_y, high_x, high_y = box
    along = np.linspace(0, 1, 33)
    x, y = low_x + (high_x - low_x) * along, low_y + (high_y - low_y) * along
    still = np.ones_like(along)
    return (
        np.concatenate([x, x, low_x * still, high_x * still]),
        np.concatenate([low_y * still, high_y * still, y, y]),
    )
