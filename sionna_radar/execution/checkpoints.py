"""Checkpoints of a long run, from which `--resume` continues.

A checkpoint is a file named by its key, in a folder inside the output folder of its run. It is written to a
temporary name and renamed, so it is complete or absent. The folder records which run its checkpoints belong to;
those of another run are refused. The operating system releases its lock when the process ends for any reason. Once
the results are written, the checkpoints are removed.
"""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from sionna_radar.execution.staging import remedy_of
from sionna_radar.foundation.errors import InputFileError, OutputError, PluginError, ScenarioError

FOLDER = ".sionna-radar-parts"
RUN, LOCK, UNFINISHED = "run.json", "lock", ".unfinished"


@dataclass(frozen=True)
class Checkpoints:
    """The checkpoints of one run: results of finished tasks by key."""

    folder: Path

    def __len__(self) -> int:
        return sum(1 for _ in self.folder.glob("*.part"))

    def __contains__(self, key: str) -> bool:
        return self._path(key).exists()

    def get(self, key: str) -> bytes | None:
        """Return the result of a task; None if it has none yet."""
        try:
            return self._path(key).read_bytes()
        except FileNotFoundError:
            return None

    def put(self, key: str, content: bytes) -> None:
        """Save the result of a task; raises OutputError if it cannot be written."""
        path = self._path(key)
        beside = path.with_suffix(UNFINISHED)
        try:
            with beside.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
        except OSError as error:
            with suppress(OSError):  # only a temporary file is left behind
                beside.unlink()
            message = f"a result cannot be saved in {self.folder} ({error.strerror}); {remedy_of(error)}"
            raise OutputError(message) from error

    def _path(self, key: str) -> Path:
        return self.folder / f"{sha256(key.encode()).hexdigest()[:32]}.part"


@contextmanager
def open_checkpoints(directory: Path, run: Mapping[str, Any], *, resume: bool) -> Iterator[Checkpoints]:
    """Yield the checkpoints of a run in its output folder; on a normal exit they are removed.

    Parameters
    ----------
    directory:
        Output folder of the run; it is made if it is missing.
    run:
        Everything the results depend on, as a JSON document: scenario, seed, versions.
    resume:
        Whether to continue from existing checkpoints.

    Raises
    ------
    OutputError
        Another process is writing into the folder; it holds checkpoints of another run, or checkpoints while
        `resume` is false; or it is not writable.
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
        raise OutputError(f"output = {directory} cannot be written ({error.strerror}); name another folder") from error
    parts, begun = Checkpoints(folder), False
    earlier = len(parts)
    try:
        _take_over(parts, directory, json.loads(json.dumps(run)), resume)
        begun = True
        yield parts
    except BaseException as error:
        lock.release()
        refused = isinstance(error, ScenarioError | PluginError)
        if len(parts) and begun and not refused:
            mended = "once the file is mended, " if isinstance(error, InputFileError) else ""
            error.add_note(f"finished tasks are saved; {mended}continue with the same command and --resume")
        elif len(parts) == 0 or (refused and begun and not earlier):
            # A request that would be refused again cannot be continued; what an earlier run saved stays all the same.
            _remove(folder, directory if made else None)
        raise
    lock.release()
    _remove(folder)


def has_checkpoints(directory: Path) -> bool:
    """Return True if a folder holds checkpoints of an unfinished run."""
    return len(Checkpoints(directory / FOLDER)) > 0


def _take_over(parts: Checkpoints, directory: Path, run: dict[str, Any], resume: bool) -> None:
    """Check that the checkpoints in a folder belong to this run, or start the run."""
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
        raise OutputError(f"{kept}this run, which was interrupted; go on with --resume, or remove {parts.folder}")


def _remove(folder: Path, directory: Path | None = None) -> None:
    """Remove a folder of checkpoints, and the output folder if it was created for them."""
    for path in [*folder.glob("*.part"), *folder.glob(f"*{UNFINISHED}"), folder / RUN, folder / LOCK]:
        path.unlink(missing_ok=True)
    for emptied in (folder, directory):
        if emptied is not None and emptied.is_dir() and not any(emptied.iterdir()):
            emptied.rmdir()
