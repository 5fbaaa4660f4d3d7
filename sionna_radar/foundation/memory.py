"""Memory of this process."""

import sys

# glibc's `mallopt` parameter of this name (malloc.h), and how many heaps threads share.
M_ARENA_MAX, ARENAS = -8, 2


def share_heaps() -> None:
    """Have all threads of this process allocate from few heaps; nothing where the C library has no such setting.

    By default glibc gives each thread its own, up to eight a core. What one thread frees, the others cannot use: the
    blocks of a long flight then hold tens of megabytes that are free.
    """
    import ctypes

    try:
        setting = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library; Windows
        return
    setting(M_ARENA_MAX, ARENAS)


def peak_memory_mb() -> float:
    """Return the largest resident memory of this process so far; NaN where the system does not report it."""
    try:
        import resource
    except ImportError:
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
