"""Raster files: safe opening of terrain, ground cover and results, and writing of cloud-optimised GeoTIFFs.

GDAL opens far more than files: server addresses, XML text instead of a name, and small files that refer to
others, whatever their suffix. Only regular files of self-contained formats are accepted here, and none that
claims more than can be read.

GDAL's COG driver writes rasters: tiled, with overviews, statistics, units and what made them. They hold neither a date
nor a path, so that equal surveys give equal files.
"""

import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rasterio
from jaxtyping import Float32, Shaped
from pyproj.exceptions import ProjError
from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader, MemoryFile
from rasterio.transform import Affine

from sionna_radar.foundation.city_models import refuse_city_model
from sionna_radar.foundation.errors import InputFileError, RadarError, reason_of
from sionna_radar.foundation.input_file import network_allowed, regular_file, shown
from sionna_radar.foundation.raster_band import band_values
from sionna_radar.foundation.xyz_grid import SUFFIX, read_xyz

# GeoTIFF, Esri ASCII grid, SRTM height, USGS and military elevation models, and plain binary grids with a header.
DRIVERS = ("GTiff", "AAIGrid", "SRTMHGT", "USGSDEM", "DTED", "EHdr", "ENVI", "PNG")
MAX_BYTES = 100_000_000_000
MAX_CELLS = 10_000_000_000
# Files next to a raster that GDAL reads implicitly, in any format; only TIFF is accepted, by its first bytes.
SIDE_CARS = (".msk", ".ovr")
TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
# A block is decoded as a whole, however little of it is needed.
MAX_BLOCK_BYTES = 1_000_000_000
REMEDY = "give a GeoTIFF, an Esri ASCII grid, an SRTM .hgt or an .xyz grid, or convert it with gdal_translate"


# Heights beyond this are treated as corrupt, m.
HIGHEST_M = 1e7


class SquareCells(NamedTuple):
    """Heights of a raster file on square cells, rows from south to north, NaN for none; middle of the first cell."""

    west_m: float
    south_m: float
    spacing_m: float
    height_m: Float32[np.ndarray, "row column"]


# GDAL options for network files: no directory listing, bounded waiting.
NETWORK_OPTIONS = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
    "GDAL_HTTP_TIMEOUT": "60",
    "GDAL_HTTP_CONNECTTIMEOUT": "20",
    "GDAL_HTTP_MAX_RETRY": "2",
}
SCHEMES = {"http": "/vsicurl/http://", "https": "/vsicurl/https://", "s3": "/vsis3/", "gs": "/vsigs/", "az": "/vsiaz/"}


@contextmanager
def open_raster(path: Path | str, key: str) -> Iterator[Any]:
    """Open a raster file, or the address of a GeoTIFF as a string; `key` of the scenario names it in messages.

    Raises InputFileError for an address while the network is not allowed, a file that is not regular, of no accepted
        format or larger than can be read, and if reading fails.
    """
    name = f"{key} ="
    if isinstance(path, Path) and path.suffix.lower() == SUFFIX:
        grid = read_xyz(path, name)
        step_x, step_y = grid.steps
        corner = Affine(step_x, 0.0, grid.west - step_x / 2, 0.0, -step_y, grid.north + step_y / 2)
        with opened_array(grid.height, corner) as dataset:
            yield dataset
        return
    if isinstance(path, str):
        place, size, drivers, options = _reached(path, name), MAX_BYTES, ["GTiff"], NETWORK_OPTIONS
    else:
        size = regular_file(path, name, REMEDY, MAX_BYTES)
        refuse_city_model(path, name)
        _check_side_cars(path, name)
        place, drivers, options = str(path.absolute()), list(DRIVERS), {}
    try:
        with warnings.catch_warnings():
            # The caller decides whether a georeference is needed.
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.Env(**options), DatasetReader(place, driver=drivers) as dataset:
                _check_size(dataset, size, f"{name} {shown(path)}")
                yield dataset
    except RadarError:
        raise
    except (RasterioError, CRSError, ProjError, OSError) as error:
        reason = reason_of(error.__cause__ or error)
        raise InputFileError(f"{name} {shown(path)} cannot be read as a raster ({reason}); {REMEDY}") from error


@contextmanager
def opened_array(height_m: Shaped[np.ndarray, "row column"], transform: Affine) -> Iterator[Any]:
    """Open an array as if it were a raster file, georeferenced by its transform."""
    rows, columns = height_m.shape
    profile = {"driver": "GTiff", "count": 1, "dtype": height_m.dtype, "height": rows, "width": columns}
    with MemoryFile() as memory:
        with memory.open(**profile, transform=transform) as writable:
            writable.write(height_m, 1)
        with memory.open() as dataset:
            yield dataset


def _reached(address: str, name: str) -> str:
    """Return GDAL's name of an address, if the network is allowed."""
    if not network_allowed():
        message = f"{name} {shown(address)} is on the network; allow it with --allow-network, or download the file"
        raise InputFileError(message)
    scheme, _, rest = address.partition("://")
    if scheme.lower() not in SCHEMES or not rest:
        message = f"{name} {shown(address)} is not a readable address; give one of {'://, '.join(SCHEMES)}://"
        raise InputFileError(message)
    return SCHEMES[scheme.lower()] + rest


def require_cells(dataset: Any, named: str, wanted: str) -> None:
    """Raise InputFileError for a raster, named, without a band of numbers (wanted), or with cells of zero size."""
    if dataset.count == 0 or np.dtype(dataset.dtypes[0]).kind not in "iuf":
        raise InputFileError(f"{named}: has no band of {wanted}")
    if dataset.transform.is_degenerate:
        raise InputFileError(f"{named}: has cells of zero size; repair its geotransform with gdal_translate -a_ullr")


def read_square_cells(dataset: Any, named: str, remedy: str, most_cells: int) -> SquareCells:
    """Return the first band of an open raster, named, with square cells and north up.

    Raises InputFileError, with a remedy, for other cells, for more than `most_cells`, and without heights.
    """
    require_cells(dataset, named, "heights")
    turn = dataset.transform
    square = turn.b == turn.d == 0 and 0 < turn.a < 1e6 and math.isclose(turn.a, -turn.e)
    if not square or not math.isfinite(turn.c) or not math.isfinite(turn.f):
        raise InputFileError(f"{named} has no square cells with north up; {remedy}")
    if dataset.width * dataset.height > most_cells:
        message = f"{named} has {dataset.width:,} x {dataset.height:,} cells, more than {most_cells:,}; {remedy}"
        raise InputFileError(message)
    height_m = band_values(dataset, dataset.read(1, masked=True)).astype(np.float32)
    height_m[~(np.abs(height_m) < HIGHEST_M)] = np.nan
    return SquareCells(
        west_m=turn.c + turn.a / 2,
        south_m=turn.f - turn.a * (dataset.height - 0.5),
        spacing_m=turn.a,
        height_m=height_m[::-1],
    )


def _check_side_cars(path: Path, name: str) -> None:
    """Refuse a mask or overviews next to a raster that are not TIFF: such a file could refer to anything."""
    wanted = {path.name.lower() + suffix for suffix in SIDE_CARS}
    for side_file in path.parent.iterdir():
        if side_file.name.lower() in wanted:
            regular_file(side_file, name, "remove it", MAX_BYTES)
            with side_file.open("rb") as file:
                if file.read(4) not in TIFF_STARTS:
                    message = f"{name} {shown(path)} has {side_file.name} next to it, which is not a TIFF; remove it"
                    raise InputFileError(message)


def _check_size(dataset: Any, file_bytes: int, name: str) -> None:
    rows, columns = dataset.shape
    cells = rows * columns
    if cells > MAX_CELLS:
        message = f"{name} has {columns:,} x {rows:,} cells, more than {MAX_CELLS:,}; cut out the part that is flown"
        raise InputFileError(message)
    if dataset.driver == "AAIGrid" and 2 * cells - 1 > file_bytes:  # a digit and a space for each
        message = f"{name} claims {columns:,} x {rows:,} cells but has only {file_bytes:,} bytes; get the whole file"
        raise InputFileError(message)
    if dataset.count:
        # Complex integers have no NumPy type; 16 bytes is the maximum for a cell.
        block = 16 * math.prod(dataset.block_shapes[0])
        if block > MAX_BLOCK_BYTES:
            raise InputFileError(
                f"{name} is stored in blocks of {block:,} bytes, more than {MAX_BLOCK_BYTES:,}; "
                "store it in tiles, with gdal_translate -co TILED=YES"
            )


# Pixels along the side of a tile; overviews halve a raster until it fits into one.
TILE = 256


def write_pixels(
    path: Path,
    pixels: Float32[np.ndarray, "row column"],
    transform: tuple[float, ...],
    crs_wkt: str | None,
    description: str,
    unit: str,
    metadata: Mapping[str, str],
) -> None:
    """Write values, from north to south and NaN for none, as a cloud-optimised GeoTIFF with metadata.

    The band has its description, its unit, and the statistics of its pixels as GDAL names them (STATISTICS_MINIMUM,
    _MAXIMUM, _MEAN, _STDDEV, _VALID_PERCENT): programs show them without reading a pixel.
    transform: the six numbers from columns and rows, counted from the north-west corner, to coordinates in the CRS.
    """
    profile = {
        "driver": "COG",
        "dtype": "float32",
        "count": 1,
        "height": pixels.shape[0],
        "width": pixels.shape[1],
        "nodata": np.nan,
        "crs": crs_wkt,
        "transform": Affine(*transform),
        "blocksize": TILE,
        "compress": "deflate",
        "predictor": "YES",
        # The default of the driver depends on the version of GDAL; an average leaves out empty cells.
        "overview_resampling": "average",
        "num_threads": "1",
    }
    with warnings.catch_warnings():
        # rasterio takes a local raster of unit cells in the corner of the frame for one without a transform.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile) as file:
            file.write(pixels, 1)
            file.set_band_description(1, description)
            file.units = (unit,)
            file.update_tags(1, **_statistics(pixels))
            file.update_tags(**metadata, QUANTITY=description, UNITS=unit)


def _statistics(pixels: Float32[np.ndarray, "row column"]) -> dict[str, str]:
    """Return the statistics of the filled pixels, as written; without any, only that there is none."""
    values = pixels[np.isfinite(pixels)].astype(float)
    valid = {"STATISTICS_VALID_PERCENT": f"{100 * len(values) / max(pixels.size, 1):.4g}"}
    if len(values) == 0:
        return valid
    statistics = {"MINIMUM": values.min(), "MAXIMUM": values.max(), "MEAN": values.mean(), "STDDEV": values.std()}
    return {f"STATISTICS_{name}": repr(float(value)) for name, value in statistics.items()} | valid
