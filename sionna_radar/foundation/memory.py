"""Memory of this process."""

import sys
from collections.abc import Callable

# Parameters of glibc's `mallopt` (malloc.h), and what they are set to: how many heaps threads share, how much free
# memory a heap keeps at its end, and from which size on an array is a mapping of its own; glibc allows no larger one.
M_ARENA_MAX, ARENAS = -8, 2
M_TRIM_THRESHOLD, KEPT_BYTES = -1, 256 << 20
M_MMAP_THRESHOLD, LARGE_BYTES = -3, 32 << 20


def tune_heaps() -> None:
    """Set how this process gets its memory for blocks of pulses; nothing where the C library has no such settings.

    All threads allocate from few heaps. By default glibc gives each thread its own, up to eight a core, and what one
    thread frees, the others cannot use: the blocks of a long flight then hold tens of megabytes that are free.

    What a block frees is kept for the next one. By default much of it goes back to the system, and fresh pages cost as
    much as what is written into them: of a wavefront of a million rays, a third of the time.
    """
    import ctypes

    try:
        setting = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library; Windows
        return
    setting(M_ARENA_MAX, ARENAS)
    setting(M_TRIM_THRESHOLD, KEPT_BYTES)
    setting(M_MMAP_THRESHOLD, LARGE_BYTES)


def release_memory() -> None:
    """Give memory that is free back to the system; nothing where the C library cannot.

    What many small blocks have left lies in pieces, in which large arrays find no room.
    """
    import ctypes

    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # another C library; Windows
        return
    trim(0)


def let_rest(part: object) -> None:
    """Let what has a method `rest` give back memory until it is used again."""
    rest: Callable[[], None] | None = getattr(part, "rest", None)
    if rest is not None:
        rest()


def peak_memory_mb() -> float:
    """Return the largest resident memory of this process so far; NaN where the system does not report it."""
    try:
        import resource
    except ImportError:
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
