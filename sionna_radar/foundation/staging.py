"""Folders in which results are written before they are put in place, and leftovers of killed runs.

A staging folder contains a file that its process keeps locked. The system releases the lock when the process ends,
however it ends, so an unlocked staging folder is an abandoned one.
"""

import errno
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PREFIX = ".sionna-radar-"
LOCK, OWNER = "lock", "owner"
OWNER_TEXT = "Unfinished results of sionna-radar; the next run removes this folder if its own run has ended.\n"


def remedy_of(error: OSError) -> str:
    """Return what a user can do about a folder or file that cannot be written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "free some space"
    if error.errno == errno.ENOENT:
        return "it was removed during the run: leave it there, and run the command again"
    return "check its permissions, or name another folder"


@contextmanager
def staged(parent: Path) -> Iterator[Path]:
    """Yield a new staging folder inside a folder, and remove it afterwards with all its contents."""
    # Slow to import, and not needed by all commands.
    from filelock import FileLock

    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
    lock = FileLock(folder / LOCK)
    try:
        with lock:
            # Written under the lock: a staging folder with this file but no lock is abandoned.
            (folder / OWNER).write_text(OWNER_TEXT, encoding="utf-8")
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def abandoned(parent: Path) -> Iterator[Path]:
    """Yield the staging folders inside a folder whose processes have ended; each is removed afterwards."""
    from filelock import FileLock, Timeout

    for folder in sorted(parent.glob(f"{PREFIX}*")):
        try:
            if folder.is_symlink() or not (folder / OWNER).is_file():
                continue
            with FileLock(folder / LOCK, blocking=False):
                yield folder
        except (Timeout, PermissionError):
            continue  # in use, or another user's
        shutil.rmtree(folder, ignore_errors=True)


def in_use(path: Path) -> bool:
    """Return whether a path is a staging folder; once `abandoned` is exhausted, one of a live run."""
    return path.name.startswith(PREFIX) and (path / OWNER).is_file()
