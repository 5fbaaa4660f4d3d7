"""NetCDF files: writing block by block with the conventions of CF-1.11, and reading files from any source.

netCDF-4 is a profile of HDF5. h5netcdf writes it without the netCDF library; xarray, Panoply, MATLAB and `ncdump` read
it. The same content gives the same bytes: no time of writing is kept.

Of a file from any source only what lies in the file itself is read, in chunks that fit into memory; a file that is
damaged, or is none, ends in one `InputFileError` that names it.
"""

import errno
import math
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

import h5netcdf
import h5py
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import DTypeLike

from sionna_radar.foundation.errors import InputFileError, reason_of
from sionna_radar.foundation.input_file import regular_file, shown
from sionna_radar.survey.recordings.table_reader import error_of_tables

# Of a variable whose length is known, and of one that grows, which may stay short.
CHUNK_BYTES, GROWING_BYTES = 1_000_000, 200_000
# What the HDF5 library may hold back until a file is closed: a cache of chunks for each variable.
SPARE_BYTES = 40_000_000


def check_room(folder: Path, wanted: int) -> None:
    """Raise OSError while there is room to close a file: on a full disk the HDF5 library would crash."""
    free, needed = shutil.disk_usage(folder).free, wanted + SPARE_BYTES
    if free < needed:
        raise OSError(errno.ENOSPC, f"{free / 1e6:.0f} MB are free, and {needed / 1e6:.0f} are needed")


class NetcdfFile:
    """A netCDF file with attributes that is being written; a dimension without a size grows."""

    def __init__(self, path: Path, attributes: Mapping[str, Any]) -> None:
        self._folder = path.parent
        self._path: Path | None = path  # until it is closed
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
        if self._path is not None:
            with suppress(OSError):  # removed before it was closed
                _sound.add(_state_of(self._path))
            self._path = None

    def _chunks(self, dimensions: tuple[str, ...], dtype: np.dtype) -> tuple[int, ...]:
        """Return the length of a chunk along each dimension, whole rows of the first."""
        sizes = [self._file.dimensions[name].size for name in dimensions]
        row_bytes = dtype.itemsize * int(np.prod(sizes[1:], dtype=np.int64))
        grows = dimensions[0] in self._length
        rows = max(1, (GROWING_BYTES if grows else CHUNK_BYTES) // max(row_bytes, 1))
        if not grows:
            rows = max(1, min(rows, sizes[0]))
        return (rows, *(max(1, size) for size in sizes[1:]))


MAX_BYTES = 10**13
LONGEST_TEXT = 10_000_000
# States of files whose tables are sound: another process has read them, or this one has written them.
_sound: set[tuple[int, ...]] = set()
# HDF5 reads and unpacks whole chunks.
MAX_CHUNK_BYTES = 256_000_000
# Rows that lie apart are read one by one if they are few, and otherwise picked out of slabs.
FEW_ROWS, SLAB_ROWS = 512, 65_536
SAME_UNITS = {"m": ("metre", "meter", "metres", "meters"), "m s-1": ("m/s",), "s": ("second", "seconds", "sec")}


@contextmanager
def open_netcdf(path: Path, name: str, remedy: str) -> Iterator["NetcdfInput"]:
    """Open a netCDF-4 file, asked for by a name; InputFileError, then or while it is read, if it is none or damaged.

    remedy: what to give instead of a file that is none.
    """
    regular_file(path, name, remedy, MAX_BYTES)
    where = f"{name} {shown(path)}"
    _probe(path, where, remedy)
    try:
        with h5py.File(path, "r") as file:
            yield NetcdfInput(file, where, remedy)
    except InputFileError:
        raise
    except (OSError, RuntimeError, KeyError, UnicodeDecodeError) as error:
        reason = shown(reason_of(error))[1:-1]
        raise InputFileError(f"{where} cannot be read as netCDF-4 ({reason}); {remedy}") from error


def _probe(path: Path, where: str, remedy: str) -> None:
    """Refuse a file whose tables are damaged: another process reads them first, as they may crash the HDF5 library."""
    state = _state_of(path)
    if not sys.executable or state in _sound:
        return
    if why := error_of_tables(path):
        raise InputFileError(f"{where} cannot be read as netCDF-4 ({shown(why)[1:-1]}); {remedy}")
    _sound.add(state)


def _state_of(path: Path) -> tuple[int, ...]:
    """Return device, inode, size and modification time of a file, which differ for another file or after a change."""
    found = path.stat()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


class NetcdfInput:
    """An open netCDF-4 file."""

    def __init__(self, file: h5py.File, where: str, remedy: str) -> None:
        self._file, self._where, self._remedy = file, where, remedy

    def __contains__(self, name: str) -> bool:
        return name in self._file

    def __iter__(self) -> Iterator[str]:
        return iter(self._file)

    @property
    def attributes(self) -> Mapping[str, Any]:
        """Attributes of the file."""
        return {key: _plain(value) for key, value in self._file.attrs.items()}

    def fail(self, what: str) -> NoReturn:
        """Raise the error of this file."""
        raise InputFileError(f"{self._where}: {what}")

    def variable(self, name: str, shape: tuple[int, ...] | None = None) -> h5py.Dataset:
        """Return a variable of numbers or text, of some shape if one is given."""
        if not isinstance(self._file.get(name, getlink=True), h5py.HardLink):
            self.fail(f"has no variable {name!r}; {self._remedy}")
        found = self._file[name]
        if not isinstance(found, h5py.Dataset) or found.is_virtual or found.external:
            self.fail(f"{name!r} is not a variable with values in this file; {self._remedy}")
        if found.chunks and math.prod(found.chunks) * found.dtype.itemsize > MAX_CHUNK_BYTES:
            self.fail(f"{name!r} lies in chunks of more than {MAX_CHUNK_BYTES:,} bytes; write it in smaller ones")
        if shape is not None and found.shape != shape:
            self.fail(f"{name!r} has the shape {found.shape}, not {shape}")
        return found

    def attributes_of(self, name: str) -> Mapping[str, Any]:
        """Return the attributes of a variable; none if there is no such variable."""
        return {key: _plain(value) for key, value in self.variable(name).attrs.items()} if name in self else {}

    def check_unit(self, name: str, unit: str) -> None:
        """Fail if a variable states another unit; times may count from a date."""
        found = str(self.attributes_of(name).get("units", unit)).split(" since ")[0]
        if found not in (unit, *SAME_UNITS.get(unit, ())):
            self.fail(f"{name} has the unit {found!r}; give it in {unit}")

    def unpacked(self, variable: h5py.Dataset, values: np.ndarray) -> np.ndarray:
        """Return real numbers of a variable as its `scale_factor` and `add_offset` say; NaN for its `_FillValue`."""
        if values.dtype.kind not in "fiu":
            return values
        packing, wide = {key: _plain(value) for key, value in variable.attrs.items()}, values.astype(np.float64)
        for key, apply in (("scale_factor", np.multiply), ("add_offset", np.add)):
            if key in packing:
                if not isinstance(packing[key], int | float) or not math.isfinite(packing[key]):
                    self.fail(f"the attribute {key} is no finite number; record it again")
                wide = apply(wide, float(packing[key]))
        return np.where(values == packing["_FillValue"], np.nan, wide) if "_FillValue" in packing else wide

    def numbers(self, name: str, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
        """Return all values of a variable, each of which must be a finite number."""
        return self.finite(self.variable(name, shape)[...], name)

    def finite(self, values: np.ndarray, name: str) -> Float[np.ndarray, "..."]:
        """Return values of a variable as float64, or fail if one is no finite number."""
        if values.dtype.kind not in "fiu":
            self.fail(f"{name!r} holds no numbers, but {values.dtype}")
        array = np.asarray(values, dtype=np.float64)
        if not np.isfinite(array).all():
            self.fail(f"{name!r} holds values that are no finite numbers; leave them out")
        return array

    def text(self, name: str) -> str:
        """Return a text."""
        variable = self.variable(name)
        if variable.shape != ():
            self.fail(f"{name!r} has the shape {variable.shape}; a single text is expected")
        value = variable[()]
        text = value.decode("utf-8") if isinstance(value, bytes) else str(value)
        if len(text) > LONGEST_TEXT:
            self.fail(f"{name!r} is longer than {LONGEST_TEXT:,} characters")
        return text

    def rows(self, variable: h5py.Dataset, index: Int[np.ndarray, " row"]) -> np.ndarray:
        """Return rows of a variable by their numbers, without reading much more than these."""
        if len(index) == 0:
            return np.zeros((0, *variable.shape[1:]))
        first, last = int(index.min()), int(index.max())
        if last - first < 2 * len(index):
            return np.asarray(variable[first : last + 1])[index - first]
        if len(index) <= FEW_ROWS:
            return np.stack([variable[row] for row in index])
        rows = np.empty((len(index), *variable.shape[1:]), dtype=variable.dtype)
        for start in range(first, last + 1, SLAB_ROWS):
            own = (index >= start) & (index < start + SLAB_ROWS)
            if own.any():
                rows[own] = variable[start : start + SLAB_ROWS][index[own] - start]
        return rows


def _plain(value: Any) -> Any:
    """Return an attribute as Python's own type, as netCDF's scalars are often arrays of one."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    if isinstance(value, np.ndarray):
        return value.item() if value.size == 1 else value
    return value.item() if isinstance(value, np.generic) else value
