"""Staging folders of unfinished output.

A staging folder contains a file that its process keeps locked. The system releases the lock when the process ends,
however it ends, so an unlocked staging folder is an abandoned one.
"""

import errno
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

PREFIX = ".sionna-radar-"
STAGING_LOCK, OWNER = "lock", "owner"
OWNER_TEXT = "Unfinished results of sionna-radar; removed by the next run if the run that wrote them has ended.\n"


def remedy_of(error: OSError) -> str:
    """Return the remedy for a folder or file that cannot be written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "free some space"
    if error.errno == errno.ENOENT:
        return "it was removed during the run; run the command again and leave the folder in place"
    return "check its permissions, or name another folder"


@contextmanager
def staged(parent: Path) -> Iterator[Path]:
    """Yield a new staging folder inside a folder, and remove it afterwards with all its contents."""
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
    lock = FileLock(folder / STAGING_LOCK)
    try:
        with lock:
            # Written under the lock: a staging folder with this file but no lock is abandoned.
            (folder / OWNER).write_text(OWNER_TEXT, encoding="utf-8")
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def abandoned(parent: Path) -> Iterator[Path]:
    """Yield the staging folders inside a folder whose processes have ended; each is removed afterwards."""
    for folder in sorted(parent.glob(f"{PREFIX}*")):
        try:
            if folder.is_symlink() or not (folder / OWNER).is_file():
                continue
            with FileLock(folder / STAGING_LOCK, blocking=False):
                yield folder
        except (Timeout, PermissionError):
            continue  # in use, or another user's
        shutil.rmtree(folder, ignore_errors=True)


def in_use(path: Path) -> bool:
    """Return True if a path is a staging folder; once `abandoned` is exhausted, one of a live run."""
    return path.name.startswith(PREFIX) and (path / OWNER).is_file()
