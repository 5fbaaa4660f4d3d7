"""Folders of results, written beside and put in place at once with a manifest; and single signed files.

A result is written to a staging folder and put in place by renames, so that a failure, a full disk or an
interrupt leaves an earlier result as it was. A new folder takes one rename. In an existing folder, the files of the
earlier result, listed in its manifest and unchanged since, move out one by one, the manifest first, and those of the
new result move in, the manifest last: a folder without a manifest, with a staging folder inside, is one whose
replacement was interrupted, and the next run restores the earlier result.

Only listed and unchanged files are ever replaced. Files that the user added, edited or replaced belong to the user.
"""

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from sionna_radar.execution.checkpoints import FOLDER as PARTS
from sionna_radar.execution.checkpoints import abandoned, in_use, remedy_of, staged
from sionna_radar.foundation.errors import KeptElsewhereError, OutputError
from sionna_radar.report.files.contents import COSTS, write_text

if TYPE_CHECKING:
    pass

Subject = TypeVar("Subject")
MANIFEST = "manifest.json"
# Costs differ from run to run: these files, and the last columns of this table, are not hashed.
UNHASHED = (COSTS, "runs.parquet")
TABLE, COSTS_COLUMNS = "runs.csv", 2
PROGRAM = "sionna-radar"
# Inside a staging folder: the new result, the files of the earlier one, and the manifest of the new one.
FRESH, RETIRED, COMING = "fresh", "retired", "coming.json"
MAX_NAMED = 5


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """The files of one result, by their paths inside the folder, with forward slashes.

    kind: file that every result of this kind contains, such as `summary.json`.
    files: size in bytes and SHA-256 of each file; 0 and "" for files that differ from run to run.
    run: digests of the inputs of the result, see `digests`; empty if not recorded.
    exit_code: of the run.
    """

    kind: str
    files: dict[str, tuple[int, str]]
    run: dict[str, str] = field(default_factory=dict)
    exit_code: int = 0

    @staticmethod
    def of(folder: Path, kind: str) -> "Manifest":
        """Return the manifest of everything in a folder."""
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        return Manifest(kind=kind, files={path.relative_to(folder).as_posix(): _signature(path) for path in paths})

    def holds(self, folder: Path, name: str) -> bool:
        """Return True if a file of a folder is the listed one: a regular file at its path, and unchanged."""
        path = folder / name  # neither a link nor below one, nor outside the folder
        return path.is_file() and path.resolve() == folder.resolve() / name and _signature(path) == self.files[name]

    def changed(self, folder: Path) -> list[str]:
        """Return the listed paths whose files have changed; missing files do not count."""
        return [name for name in self.files if os.path.lexists(folder / name) and not self.holds(folder, name)]

    def text(self) -> str:
        """Return the manifest as JSON."""
        files = {name: {"bytes": size, "sha256": digest} for name, (size, digest) in self.files.items()}
        run = {"run": self.run, "exit_code": self.exit_code} if self.run else {}
        return json.dumps({"written_by": PROGRAM, "kind": self.kind, "files": files, **run}, indent=2) + "\n"


def read_manifest(path: Path) -> Manifest | None:
    """Return the manifest in a file; None for any other file, or none. Raises OSError if it cannot be read."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        manifest = Manifest(
            kind=str(document["kind"]),
            files={name: (int(entry["bytes"]), str(entry["sha256"])) for name, entry in document["files"].items()},
            run={str(key): str(digest) for key, digest in document.get("run", {}).items()},
            exit_code=int(document.get("exit_code", 0)),
        )
        return manifest if document["written_by"] == PROGRAM else None
    except (FileNotFoundError, AttributeError, KeyError, TypeError, ValueError):
        return None


def _signature(path: Path) -> tuple[int, str]:
    """Return the size in bytes and the SHA-256 of what a file holds in every run."""
    if path.name in UNHASHED:
        return 0, ""
    if path.name == TABLE:
        lasting = lasting_columns(path.read_bytes())
        return len(lasting), hashlib.sha256(lasting).hexdigest()
    with path.open("rb") as file:
        return path.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest()


def lasting_columns(table: bytes) -> bytes:
    """Return the text of `TABLE` without its last columns, which hold plain numbers."""
    return b"\n".join(line.rsplit(b",", COSTS_COLUMNS)[0] for line in table.split(b"\n"))


def check_output(directory: Path, marker: str) -> Path:
    """Return the resolved directory, or raise an error before any work is done.

    Leftovers of killed runs in it or beside it are removed first, and an earlier result restored.

    Raises OutputError if it is a file, holds anything but an unchanged earlier result of this kind, or its parent is
        not a folder or cannot be written.
    """
    return _checked(directory, lambda path: _obstacle(path, marker))


def _checked(path: Path, obstacle: Callable[[Path], str]) -> Path:
    """Return the resolved path; OutputError for its obstacle, "" if there is none."""
    try:
        path = path.expanduser().resolve()
        problem = obstacle(path)
    except (OSError, RuntimeError, ValueError) as error:
        problem = f"cannot be reached ({error}); check the path and its permissions"
    if problem:
        raise OutputError(f"output = {path} {problem}")
    return path


def _obstacle(directory: Path, marker: str) -> str:
    place = next(path for path in (directory, *directory.parents) if path.exists())
    if not place.is_dir():
        return "is a file; name a folder" if place == directory else f"cannot be made: {place} is a file; name another"
    _clear_abandoned(directory)
    try:
        # Permission bits do not cover read-only mounts and quotas; creating a folder does.
        tempfile.TemporaryDirectory(dir=place).cleanup()
    except OSError as error:
        return f"cannot be made: {place} is not writable ({error.strerror}); name a folder elsewhere"
    return _unwanted(directory, marker) if place == directory else ""


def _unwanted(directory: Path, marker: str, ignored: Path | None = None) -> str:
    """Return the reason why an existing folder cannot take a result; "" if it can.

    ignored: this run's staging folder.
    """
    entries = [path for path in directory.iterdir() if path != ignored and path.name != PARTS]
    if not entries:
        return ""
    if any(map(in_use, entries)):
        return "is being written by another run; wait for it or name another folder"
    earlier = read_manifest(directory / MANIFEST)
    if earlier is None:
        return (
            f"is not empty and holds no earlier result (no {MANIFEST} of this program); "
            "name a new or empty folder, or empty this one"
        )
    if earlier.kind != marker:
        return f"holds the result of another command ({earlier.kind}, not {marker}); name another folder"
    changed = earlier.changed(directory)
    if changed:
        remainder = f" and {len(changed) - MAX_NAMED} more" if len(changed) > MAX_NAMED else ""
        return (
            f"holds files of an earlier result that were changed since ({', '.join(changed[:MAX_NAMED])}{remainder}); "
            "move them away or name another folder"
        )
    return ""


def write_folder(directory: Path, marker: str, fill: Callable[[Path], None]) -> list[Path]:
    """Fill a folder by a function, put it in place with its manifest, and return the files written.

    directory: output folder; only the files of an earlier result in it are replaced.
    marker: file that every result of this kind contains, and that identifies the kind.
    fill: writes the results into the given folder.

    Raises KeptElsewhereError if the directory holds other files, or a file in it cannot be replaced; the result is
        saved beside it.
    Raises OutputError if the results cannot be written at all.
    """
    directory = directory.expanduser().resolve()
    try:
        _clear_abandoned(directory)
        directory.parent.mkdir(parents=True, exist_ok=True)
        # Renames to the directory must stay on one file system.
        with staged(directory if directory.is_dir() else directory.parent) as staging:
            # The staging folder is private to the user; a folder inside it has the usual permissions.
            fresh = staging / FRESH
            fresh.mkdir()
            fill(fresh)
            manifest = Manifest.of(fresh, marker)
            write_text(fresh / MANIFEST, manifest.text())
            try:
                if staging.parent == directory:
                    _replace(directory, staging, manifest)
                else:
                    fresh.rename(directory)
            except OSError as error:
                saved = _keep_elsewhere(fresh, directory)
                reason = error.strerror or str(error)
                message = f"output = {directory} could not be replaced ({reason}); the new result is in {saved}"
                raise KeptElsewhereError(message) from error
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"output = {directory} cannot be written ({error}); {remedy_of(error)}") from error
    return sorted(directory / name for name in (*manifest.files, MANIFEST))


def _replace(directory: Path, staging: Path, manifest: Manifest) -> None:
    """Move the files of the earlier result out and those of the new one in; on failure undo all moves."""
    problem = _unwanted(directory, manifest.kind, ignored=staging)
    if problem:
        raise FileExistsError(f"it {problem}")
    earlier = read_manifest(directory / MANIFEST)
    retiring = [name for name in (MANIFEST, *earlier.files) if (directory / name).exists()] if earlier else []
    write_text(staging / COMING, manifest.text())
    try:
        for name in retiring:
            _move(directory, name, staging / RETIRED)
        for name in (*manifest.files, MANIFEST):
            if os.path.lexists(directory / name):
                raise FileExistsError(f"it holds a {name} that this program did not write")
            _move(staging / FRESH, name, directory)
    except BaseException:
        _put_back(directory, staging)
        raise
    _drop_empty_folders(directory, retiring)


def _clear_abandoned(directory: Path) -> None:
    """Remove leftovers of killed runs in a folder and beside it, and restore earlier results."""
    for folder in (directory, directory.parent):
        for staging in abandoned(folder):
            _put_back(folder, staging)


def _put_back(directory: Path, staging: Path) -> None:
    """Undo an interrupted replacement; do nothing for one not begun or already finished."""
    coming = read_manifest(staging / COMING)
    if coming is None or (directory / MANIFEST).exists():
        return
    for name in coming.files:
        if not (staging / FRESH / name).exists() and coming.holds(directory, name):
            _move(directory, name, staging / FRESH)
    _drop_empty_folders(directory, coming.files)
    retired = staging / RETIRED
    names = [path.relative_to(retired).as_posix() for path in retired.rglob("*") if path.is_file()]
    for name in sorted(names, key=MANIFEST.__eq__):  # the manifest last
        _move(retired, name, directory)


def _move(source: Path, name: str, target: Path) -> None:
    (target / name).parent.mkdir(parents=True, exist_ok=True)
    (source / name).replace(target / name)


def _drop_empty_folders(directory: Path, names: Iterable[str]) -> None:
    """Remove the folders of some files if they are empty."""
    folders = {directory / parent for name in names for parent in Path(name).parents} - {directory}
    for folder in sorted(folders, reverse=True):
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def _keep_elsewhere(fresh: Path, directory: Path) -> Path:
    """Move a result to a free name beside its folder, or inside it if that is impossible."""
    for parent in (directory.parent, directory):
        free = next(path for n in count(2) if not (path := parent / f"{directory.name}-{n}").exists())
        try:
            return fresh.rename(free)
        except OSError:
            continue
    raise OutputError(f"output = {directory} cannot be written, nor any folder beside it; the result is lost")


def digests(run: Mapping[str, Any]) -> dict[str, str]:
    """Return a digest of each input of a run."""
    texts = {key: json.dumps(value, sort_keys=True) for key, value in run.items()}
    return {key: hashlib.sha256(text.encode()).hexdigest()[:32] for key, text in texts.items()}


def note_run(directory: Path, run: Mapping[str, Any], exit_code: int) -> None:
    """Record in the manifest of a finished result its run and exit code."""
    directory = directory.expanduser().resolve()
    manifest = read_manifest(directory / MANIFEST)
    if manifest is None:
        return
    with staged(directory) as staging:
        write_text(staging / MANIFEST, replace(manifest, run=digests(run), exit_code=exit_code).text())
        _move(staging, MANIFEST, directory)


def finished_as(directory: Path, run: Mapping[str, Any], products: str) -> int | None:
    """Return the exit code of the run whose result is in a folder; None without one, or for other products.

    directory: output folder.
    run: inputs of the result, as for `note_run`.
    products: the key in it of the requested files.

    Raises OutputError if the folder holds the result of another run.
    """
    manifest = read_manifest(directory.expanduser().resolve() / MANIFEST)
    if manifest is None or not manifest.run:
        return None
    current = digests(run)
    different = [key for key in current if manifest.run.get(key) != current[key]]
    if different == [products] or any(not (directory / name).exists() for name in manifest.files):
        return None
    if different:
        raise OutputError(
            f"output = {directory} holds the result of a run with another {', '.join(different)}; "
            "name another folder, or leave out --resume to replace it"
        )
    return manifest.exit_code


@dataclass(frozen=True, kw_only=True)
class SignedFile:
    """The files of one command, each with a line that signs the rest.

    command: name of the command.
    before, after: comment delimiters of the line.
    at_end: True if the line is the last, not the first.
    """

    command: str
    before: str
    after: str = ""
    at_end: bool = False

    def check(self, path: Path) -> Path:
        """Return the resolved path, or raise an error before any work is done.

        Raises OutputError if it is a folder, a file of another origin or edited since, or its folder does not exist.
        """
        return _checked(path, self._obstacle)

    def write(self, path: Path, text: str) -> Path:
        """Write text to a file, completely or not at all, and return the file.

        Raises OutputError as `check` does.
        """
        path = self.check(path)
        try:
            with staged(path.parent) as staging:
                write_text(staging / path.name, self._signed(text))
                (staging / path.name).replace(path)
        except OSError as error:
            raise OutputError(f"output = {path} cannot be written ({error.strerror}); name another file") from error
        return path

    def _signed(self, text: str) -> str:
        line = f"{self._mark}{hashlib.sha256(text.encode('utf-8', 'replace')).hexdigest()}{self.after}\n"
        return text + line if self.at_end else line + text

    @property
    def _mark(self) -> str:
        words = f"Written by sionna-radar {self.command}, which replaces this file only unedited. SHA-256 of the rest: "
        return self.before + words

    def _obstacle(self, path: Path) -> str:
        if not path.exists():
            missing = f"cannot be written: there is no folder {path.parent}; make it or name another file"
            return "" if path.parent.is_dir() else missing
        if not path.is_file():
            return "is a folder; name a file" if path.is_dir() else "is no regular file; name another file"
        content = path.read_bytes().decode("utf-8", "replace")
        text = content.rpartition(self._mark)[0] if self.at_end else content.partition("\n")[2]
        if content != self._signed(text):
            return f"exists, and was not written by {self.command} or was edited since; name another file"
        return ""
