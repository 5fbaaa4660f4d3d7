"""Folders in which results are made before they are put in place, and what killed runs have left of them.

A staging folder holds a file that its process keeps locked. The system drops the lock when the process ends, however
it ends, so an unlocked staging folder is an abandoned one.
"""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

PREFIX = ".sionna-radar-"
LOCK, OWNER = "lock", "owner"
OWNER_TEXT = "Results in the making by sionna-radar; the next run takes this folder away if its own has ended.\n"


@contextmanager
def staged(parent: Path) -> Iterator[Path]:
    """Yield a new staging folder inside a folder, and take it away with all that is left in it."""
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
    lock = FileLock(folder / LOCK)
    try:
        with lock:
            # Written under the lock: a staging folder with this file and no lock has lost its process.
            (folder / OWNER).write_text(OWNER_TEXT, encoding="utf-8")
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def abandoned(parent: Path) -> Iterator[Path]:
    """Yield the staging folders inside a folder whose processes have ended; each is taken away afterwards."""
    for folder in sorted(parent.glob(f"{PREFIX}*")):
        if folder.is_symlink() or not (folder / OWNER).is_file():
            continue
        try:
            with FileLock(folder / LOCK, blocking=False):
                yield folder
        except (Timeout, PermissionError):
            continue  # in use, or another user's
        shutil.rmtree(folder, ignore_errors=True)


def in_use(path: Path) -> bool:
    """Tell whether a path is a staging folder; once `abandoned` has been used up, one of a run that goes on."""
    return path.name.startswith(PREFIX) and (path / OWNER).is_file()
