"""The one door through which raster files are opened: terrain and ground cover alike.

GDAL opens far more than files: addresses of servers, XML text in place of a name, and small files that point to
others, whatever their name ends in. Here only regular files of formats that hold their own cells pass, and none that
claims more than can be read.
"""

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from pyproj.exceptions import ProjError
from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader

from sionna_radar.foundation.errors import InputFileError, RadarError
from sionna_radar.foundation.input_file import regular_file, shown

# GeoTIFF, Esri ASCII grid, SRTM height, USGS and military elevation models, and plain binary grids with a header.
DRIVERS = ("GTiff", "AAIGrid", "SRTMHGT", "USGSDEM", "DTED", "EHdr", "ENVI", "PNG")
MOST_BYTES = 100_000_000_000
MOST_CELLS = 10_000_000_000
# Files beside a raster that GDAL reads without being asked, by any format; only TIFF passes, by its first bytes.
SIDE_CARS = (".msk", ".ovr")
TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
# A block is decoded whole, however little of it is wanted.
MOST_BLOCK_BYTES = 1_000_000_000
REMEDY = "give a GeoTIFF, an Esri ASCII grid or an SRTM .hgt, or convert it with gdal_translate"


@contextmanager
def open_raster(path: Path, key: str) -> Iterator[Any]:
    """Open a raster file for reading, and turn what GDAL and PROJ raise about it into one error.

    Parameters
    ----------
    path:
        The file.
    key:
        The scenario's key that names it, for messages.

    Raises
    ------
    InputFileError
        It is not a regular file, not of an accepted format, or larger than can be read; or reading it fails.

    """
    name = f"{key} ="
    size = regular_file(path, name, REMEDY, MOST_BYTES)
    _check_side_cars(path, name)
    try:
        with warnings.catch_warnings():
            # Whether a place on the Earth is needed is for the caller to say.
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.Env(), DatasetReader(str(path.absolute()), driver=list(DRIVERS)) as dataset:
                _check_size(dataset, size, f"{name} {shown(path)}")
                yield dataset
    except RadarError:
        raise
    except (RasterioError, CRSError, ProjError, OSError) as error:
        reason = str(error.__cause__ or error).splitlines()[0]
        message = f"{name} {shown(path)} cannot be read as a raster ({reason}); {REMEDY}"
        raise InputFileError(message) from error


def require_cells(dataset: Any, named: str, wanted: str) -> None:
    """Raise InputFileError for a raster without a band of numbers or with cells of no size.

    named: the file in messages; wanted: what its numbers should be, and what to give instead.
    """
    if dataset.count == 0 or np.dtype(dataset.dtypes[0]).kind not in "iuf":
        message = f"{named}: holds no band of {wanted}"
        raise InputFileError(message)
    if dataset.transform.is_degenerate:
        message = f"{named}: has cells of no size; repair its geotransform with gdal_translate -a_ullr"
        raise InputFileError(message)


def _check_side_cars(path: Path, name: str) -> None:
    """Refuse a mask or overviews beside a raster that are no TIFF: such a file could point anywhere."""
    wanted = {path.name.lower() + suffix for suffix in SIDE_CARS}
    for beside in path.parent.iterdir():
        if beside.name.lower() in wanted:
            regular_file(beside, name, "remove it", MOST_BYTES)
            with beside.open("rb") as file:
                if file.read(4) not in TIFF_STARTS:
                    message = f"{name} {shown(path)} has {beside.name} beside it, which is not a TIFF; remove it"
                    raise InputFileError(message)


def _check_size(dataset: Any, file_bytes: int, name: str) -> None:
    rows, columns = dataset.shape
    cells = rows * columns
    if cells > MOST_CELLS:
        message = f"{name} has {columns:,} x {rows:,} cells, more than {MOST_CELLS:,}; cut out the part that is flown"
        raise InputFileError(message)
    if dataset.driver == "AAIGrid" and 2 * cells - 1 > file_bytes:  # a digit and a space for each
        message = f"{name} claims {columns:,} x {rows:,} cells but has only {file_bytes:,} bytes; get the whole file"
        raise InputFileError(message)
    if dataset.count:
        # Complex integers have no NumPy type; 16 bytes is the most that a cell takes.
        block = 16 * math.prod(dataset.block_shapes[0])
        if block > MOST_BLOCK_BYTES:
            message = (
                f"{name} is stored in blocks of {block:,} bytes, more than {MOST_BLOCK_BYTES:,}; "
                "store it in tiles, with gdal_translate -co TILED=YES"
            )
            raise InputFileError(message)
