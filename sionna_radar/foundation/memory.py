"""How this process gets memory for blocks of pulses, gives it back, and how much it had."""

import sys
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

# Parameters of glibc's `mallopt` (malloc.h) and their values: the number of heaps that threads share, the free memory
# that a heap keeps at its end, and the size from which an array is mapped separately (the largest that glibc allows).
M_ARENA_MAX, ARENAS = -8, 2
M_TRIM_THRESHOLD, KEPT_BYTES = -1, 256 << 20
M_MMAP_THRESHOLD, LARGE_BYTES = -3, 32 << 20


def tune_heaps() -> None:
    """Configure malloc for blocks of pulses; no effect where the C library has no such settings.

    All threads allocate from few heaps. By default glibc gives each thread its own, up to eight a core, and what one
    thread frees, the others cannot use: the blocks of a long flight then hold tens of megabytes that are free.

    What a block frees is kept for the next one. By default much of it goes back to the system, and fresh pages cost as
    much as what is written into them: of a wavefront of a million rays, a third of the time.
    """
    setting = _c_function("mallopt")
    setting(M_ARENA_MAX, ARENAS)
    setting(M_TRIM_THRESHOLD, KEPT_BYTES)
    setting(M_MMAP_THRESHOLD, LARGE_BYTES)


def release_memory() -> None:
    """Return free memory, in whose fragments large arrays do not fit, to the operating system if the C library can."""
    _c_function("malloc_trim")(0)


def _c_function(name: str) -> Callable[..., Any]:
    """Return a function of the C library; one without effect where it has none of the name."""
    import ctypes

    try:
        return getattr(ctypes.CDLL(None), name)
    except (AttributeError, OSError, TypeError):  # another C library; Windows
        return lambda *_: None


@runtime_checkable
class HoldsMemory(Protocol):
    """A component that keeps arrays for its next call."""

    def release_memory(self) -> None:
        """Release them until the next call."""


def peak_memory_mb() -> float:
    """Return the largest resident memory of this process so far; NaN where the system does not report it."""
    try:
        import resource
    except ImportError:
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
