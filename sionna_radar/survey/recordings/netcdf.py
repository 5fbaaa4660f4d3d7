"""NetCDF files that grow block by block, with the conventions of CF-1.11.

netCDF-4 is a profile of HDF5. h5netcdf writes it without the netCDF library; xarray, Panoply, MATLAB and `ncdump` read
it. The same content gives the same bytes: no time of writing is kept.
"""

import errno
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
from numpy.typing import DTypeLike

# Of a variable whose length is known, and of one that grows, which may stay short.
CHUNK_BYTES, GROWING_BYTES = 1_000_000, 200_000
# What the HDF5 library may hold back until a file is closed: a cache of chunks for each variable.
SPARE_BYTES = 40_000_000


def check_room(folder: Path, wanted: int) -> None:
    """Raise OSError while there is room to close a file: on a full disk the HDF5 library would crash."""
    free, needed = shutil.disk_usage(folder).free, wanted + SPARE_BYTES
    if free < needed:
        message = f"{free / 1e6:.0f} MB are free, and {needed / 1e6:.0f} are needed"
        raise OSError(errno.ENOSPC, message)


class NetcdfFile:
    """A netCDF file that is being written; a dimension without a size grows.

    Parameters
    ----------
    path:
        Where to write.
    attributes:
        Of the file; the conventions are added.

    """

    def __init__(self, path: Path, attributes: Mapping[str, Any]) -> None:
        self._folder = path.parent
        check_room(self._folder, 0)
        self._file = h5netcdf.File(path, "w", track_order=False)
        self._file.attrs["Conventions"] = "CF-1.11"
        self._file.attrs.update(attributes)
        self._length: dict[str, int] = {}

    def dimension(self, name: str, size: int | None = None) -> None:
        """Add a dimension; without a size it grows."""
        self._file.dimensions[name] = size
        if size is None:
            self._length[name] = 0

    def variable(
        self,
        name: str,
        dimensions: tuple[str, ...],
        values: Any = None,
        *,
        dtype: DTypeLike | None = None,
        **attributes: Any,
    ) -> None:
        """Add a variable, with its values or empty; attributes that are None are left out."""
        given = None if values is None else np.asarray(values)
        check_room(self._folder, 0 if given is None else given.nbytes)
        wanted = np.dtype(dtype if given is None else given.dtype)
        new = self._file.create_variable(
            name, dimensions, wanted, given, chunks=self._chunks(dimensions, wanted) if dimensions else None
        )
        new.attrs.update({key: value for key, value in attributes.items() if value is not None})

    def text(self, name: str, value: str, long_name: str) -> None:
        """Add a text, which may be longer than an attribute."""
        new = self._file.create_variable(name, (), h5py.string_dtype())
        new[...] = value
        new.attrs["long_name"] = long_name

    def write(self, name: str, start: int, values: np.ndarray) -> None:
        """Write values along the first dimension of a variable."""
        check_room(self._folder, values.nbytes)
        self._file.variables[name][start : start + len(values)] = values

    def append(self, dimension: str, columns: Mapping[str, np.ndarray]) -> None:
        """Write equally long columns at the end of a dimension that grows."""
        start = self._length[dimension]
        self._length[dimension] = stop = start + len(next(iter(columns.values())))
        if stop > start:
            self._file.resize_dimension(dimension, stop)
            for name, values in columns.items():
                self.write(name, start, values)

    def close(self) -> None:
        """Close the file; once is enough, and more do no harm."""
        self._file.close()

    def _chunks(self, dimensions: tuple[str, ...], dtype: np.dtype) -> tuple[int, ...]:
        """Return the length of a chunk along each dimension, whole rows of the first."""
        sizes = [self._file.dimensions[name].size for name in dimensions]
        row_bytes = dtype.itemsize * int(np.prod(sizes[1:], dtype=np.int64))
        grows = dimensions[0] in self._length
        rows = max(1, (GROWING_BYTES if grows else CHUNK_BYTES) // max(row_bytes, 1))
        if not grows:
            rows = max(1, min(rows, sizes[0]))
        return (rows, *(max(1, size) for size in sizes[1:]))
