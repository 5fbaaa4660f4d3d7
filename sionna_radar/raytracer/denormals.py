"""Numbers too small for their exponent, taken for zero, as in Dr.Jit's own threads.

Embree asks for it. Dr.Jit sets it in the threads that it starts; where it may use one thread only, it works in the
thread that calls it, where nobody has. Rays along the edge of two triangles would then give other hits.
"""

import ctypes
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

# Words of the floating-point environment (fenv.h), which of them controls this, and its bits: on x86-64 MXCSR's "flush
# to zero" and "denormals are zero", on 64-bit Arm FPCR's "flush to zero".
ENVIRONMENTS = {"x86_64": (8, 7, 0x8040), "aarch64": (2, 0, 1 << 24)}


@contextmanager
def flushed_denormals() -> Iterator[None]:
    """Take denormal numbers for zero in this thread; nothing where `can_flush` says that it cannot be done."""
    library = _library()
    if library is None:
        yield
        return
    words, word, bits = ENVIRONMENTS[platform.machine()]
    before, within = (ctypes.c_uint32 * words)(), (ctypes.c_uint32 * words)()
    library.fegetenv(before)
    library.fegetenv(within)
    within[word] |= bits
    library.fesetenv(within)
    try:
        yield
    finally:
        library.fesetenv(before)


def can_flush() -> bool:
    """Return whether denormal numbers can be taken for zero in the threads of Python here."""
    return _library() is not None


@cache
def _library() -> Any:
    if not sys.platform.startswith("linux") or platform.machine() not in ENVIRONMENTS:
        return None
    try:
        library = ctypes.CDLL("libm.so.6")
    except OSError:  # another C library
        return None
    return library if hasattr(library, "fesetenv") else None
