"""Arrays of NumPy files (.npy, .npz), whose headers are checked before memory is taken.

An .npz may claim petabytes in a few bytes, or unpack to far more than its size.
"""

import math
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError

import numpy as np
from numpy.lib import format as npy

from sionna_radar.foundation.errors import InputFileError, reason_of
from sionna_radar.foundation.input_file import shown

# Arrays of an .npz are unpacked into memory; an .npy is mapped, and may be larger.
MAX_UNPACKED_BYTES = 2**32
# What NumPy and the standard library raise for damaged, encrypted or oddly packed files.
DAMAGED = (
    *(ValueError, TypeError, LookupError, OverflowError, OSError, EOFError, SyntaxError, RuntimeError),
    *(TokenError, zipfile.BadZipFile, zlib.error, RecursionError, MemoryError),
)


@contextmanager
def readable(path: Path, what: str) -> Iterator[None]:
    """Turn errors of reading a file as something into an InputFileError that names both."""
    try:
        yield
    except InputFileError:
        raise
    except DAMAGED as error:
        reason = reason_of(error)
        raise InputFileError(f"{shown(path)}: cannot be read as {what} ({reason})") from error


def stored_arrays(path: Path, wanted: Mapping[str, str]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return those arrays of a NumPy file that are wanted, by our names, and the names of all that it has.

    A file that is no .npz has one array, by each name. Raises InputFileError for a file that is damaged, and for an
    array of an .npz beyond MAX_UNPACKED_BYTES.
    """
    with readable(path, "a NumPy file"):
        if not zipfile.is_zipfile(path):
            return dict.fromkeys(wanted, npy.open_memmap(path, mode="r")), []
        # Opened here, as `ZipFile` leaves damaged files open.
        with path.open("rb") as opened, zipfile.ZipFile(opened) as archive:
            packed = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            found = {}
            for name, key in wanted.items():
                if key in packed:
                    _check_size(path, key, archive, packed[key])
                    with archive.open(packed[key]) as file:
                        found[name] = npy.read_array(file, allow_pickle=False)
            return found, list(packed)


def _check_size(path: Path, key: str, archive: zipfile.ZipFile, packed: zipfile.ZipInfo) -> None:
    """Raise InputFileError if the header of an array states more bytes than there are, or than are unpacked."""
    with archive.open(packed) as file:
        read_header = npy.read_array_header_1_0 if npy.read_magic(file) == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = read_header(file)
        left = packed.file_size - file.tell()
    size = math.prod(shape) * dtype.itemsize
    if size > left:
        raise InputFileError(f"{shown(path)}: {key} has {left:,} bytes, and {size:,} by its header; get the whole file")
    if size > MAX_UNPACKED_BYTES:
        message = f"{key} unpacks to {size:,} bytes, more than {MAX_UNPACKED_BYTES:,}; save it as a .npy file"
        raise InputFileError(f"{shown(path)}: {message}")
