"""Whether this process may reach the network: never, unless the user allows it."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# Addresses, and the file systems behind which GDAL reaches for them.
ADDRESS = re.compile(r"(?:[a-z][a-z0-9+.-]{1,15}://|/vsi)", re.IGNORECASE)

_allowed: ContextVar[bool] = ContextVar("network_allowed", default=False)


def is_address(text: str) -> bool:
    """Whether a text leads elsewhere than to a file of this machine."""
    return bool(ADDRESS.match(text))


def network_allowed() -> bool:
    """Whether the user has allowed the network."""
    return _allowed.get()


@contextmanager
def allow_network() -> Iterator[None]:
    """Allow the network inside a `with` block, as `--allow-network` does for a command.

    Examples
    --------
    >>> far = {"terrain": {"kind": "raster", "path": "https://example.org/dem.tif"}}
    >>> scenario = load_scenario("hills", far)
    >>> with allow_network():  # prepare(scenario) would read the address here
    ...     str(scenario.terrain.path)
    'https://example.org/dem.tif'

    """
    token = _allowed.set(True)
    try:
        yield
    finally:
        _allowed.reset(token)
