"""Checkpoints, the finished parts of a long run that `--resume` goes on from, and staging folders of unfinished output.

A part is a file named by its key, kept in the output folder of its run. It is written beside and renamed, so that it is
there whole or not at all. The folder of the parts says what run they are of; those of another one are refused, never
mixed. Its lock is released by the system when the process ends, however it ends. Once the results stand in their
folder, the parts are removed.

A staging folder contains a file that its process keeps locked. The system releases the lock when the process ends,
however it ends, so an unlocked staging folder is an abandoned one.
"""

import errno
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from sionna_radar.foundation.errors import OutputError

PREFIX = ".sionna-radar-"
STAGING_LOCK, OWNER = "lock", "owner"
OWNER_TEXT = "Unfinished results of sionna-radar; the next run removes this folder if its own run has ended.\n"


def remedy_of(error: OSError) -> str:
    """Return the remedy for a folder or file that cannot be written."""
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
    from filelock import FileLock, Timeout

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
    """Return whether a path is a staging folder; once `abandoned` is exhausted, one of a live run."""
    return path.name.startswith(PREFIX) and (path / OWNER).is_file()


FOLDER = ".sionna-radar-parts"
RUN, LOCK, UNFINISHED = "run.json", "lock", ".unfinished"


@dataclass(frozen=True)
class Checkpoints:
    """The finished parts of one run."""

    folder: Path

    def __len__(self) -> int:
        return sum(1 for _ in self.folder.glob("*.part"))

    def __contains__(self, key: str) -> bool:
        return self._path(key).exists()

    def get(self, key: str) -> bytes | None:
        """Return a part; None if it is not finished."""
        try:
            return self._path(key).read_bytes()
        except FileNotFoundError:
            return None

    def put(self, key: str, content: bytes) -> None:
        """Keep a part; raises OutputError if there is no room for it."""
        path = self._path(key)
        beside = path.with_suffix(UNFINISHED)
        try:
            with beside.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
        except OSError as error:
            with suppress(OSError):  # no more than an unfinished part is left
                beside.unlink()
            message = f"a finished part cannot be kept in {self.folder} ({error.strerror}); {remedy_of(error)}"
            raise OutputError(message) from error

    def _path(self, key: str) -> Path:
        return self.folder / f"{sha256(key.encode()).hexdigest()[:32]}.part"


@contextmanager
def open_checkpoints(directory: Path, run: Mapping[str, Any], *, resume: bool) -> Iterator[Checkpoints]:
    """Yield the parts of a run in its output folder, and remove them at the end unless an exception ends it.

    Parameters
    ----------
    directory:
        Output folder of the run; it is made if it is missing.
    run:
        What the parts depend on, as a JSON document: scenario, seed, versions.
    resume:
        Whether to go on with the parts that are there.

    Raises
    ------
    OutputError
        Another run writes into the folder; it holds parts of another run, or parts without `resume`; or it cannot be
        written.

    """
    folder = directory / FOLDER
    made = not directory.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / LOCK, blocking=False)
        lock.acquire()
    except Timeout as error:
        message = f"output = {directory} is being written by another run; wait for it or name another folder"
        raise OutputError(message) from error
    except OSError as error:
        message = f"output = {directory} cannot be written ({error.strerror}); name another folder"
        raise OutputError(message) from error
    parts, begun = Checkpoints(folder), False
    try:
        _take_over(parts, directory, json.loads(json.dumps(run)), resume)
        begun = True
        yield parts
    except BaseException as error:
        lock.release()
        if len(parts) and begun:
            error.add_note("finished parts are kept; the same command with --resume goes on from them")
        elif len(parts) == 0:
            _remove(folder, directory if made else None)
        raise
    lock.release()
    _remove(folder)


def has_checkpoints(directory: Path) -> bool:
    """Return whether a folder holds finished parts of a run that has not ended."""
    return len(Checkpoints(directory / FOLDER)) > 0


def _take_over(parts: Checkpoints, directory: Path, run: dict[str, Any], resume: bool) -> None:
    """Check that the parts in a folder are of this run, or begin it."""
    said = parts.folder / RUN
    for left in parts.folder.glob(f"*{UNFINISHED}"):
        left.unlink()
    if len(parts) == 0:
        beside = said.with_suffix(UNFINISHED)
        beside.write_text(json.dumps(run, indent=1), encoding="utf-8")
        beside.replace(said)
        return
    try:
        earlier = json.loads(said.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        earlier = {}
    different = [key for key in run if earlier.get(key) != run[key]]
    kept = f"output = {directory} holds {len(parts)} finished parts of "
    if different:
        message = f"{kept}a run with another {', '.join(different)}; name another folder, or remove {parts.folder}"
        raise OutputError(message)
    if not resume:
        message = f"{kept}this run, which was interrupted; go on with --resume, or remove {parts.folder}"
        raise OutputError(message)


def _remove(folder: Path, directory: Path | None = None) -> None:
    """Remove a folder of parts, which only this program writes to, and the output folder if it was made for it."""
    for path in [*folder.glob("*.part"), *folder.glob(f"*{UNFINISHED}"), folder / RUN, folder / LOCK]:
        path.unlink(missing_ok=True)
    for emptied in (folder, directory):
        if emptied is not None and emptied.is_dir() and not any(emptied.iterdir()):
            emptied.rmdir()
