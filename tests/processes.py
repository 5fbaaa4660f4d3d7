"""Processes that a program leaves behind."""

import time
from contextlib import suppress
from pathlib import Path


def all_ended(session: int, within_s: float = 30.0) -> bool:
    """Return whether no process of a session is left, or only for a moment; where there is no /proc it is believed."""
    ends = time.monotonic() + within_s
    while living(session):
        if time.monotonic() > ends:
            return False
        time.sleep(0.05)
    return True


def living(session: int) -> list[str]:
    """Return the processes of a session that have not ended."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            name, rest = path.read_text().rsplit(")", 1)
            state, _, _, of = rest.split()[:4]
            found += [name] if int(of) == session and state != "Z" else []
    return found
