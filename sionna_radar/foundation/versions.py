"""The versions of what decides the bits of a result."""

import platform
from importlib.metadata import PackageNotFoundError, version

PACKAGES = ("sionna-radar", "sionna-rt", "mitsuba", "drjit", "numpy", "scipy", "finufft")


def versions() -> dict[str, str | None]:
    """Return the versions of Python and of the packages that affect the numbers; None if not installed."""
    # Package metadata is read without loading Mitsuba and its LLVM.
    return {"python": platform.python_version()} | {name: _version(name) for name in PACKAGES}


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
