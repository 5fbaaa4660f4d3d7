"""Folders of results: written beside and put in place at once, with a manifest of signed files.

A result is written to a staging folder and put in place by renames, so that a failure, a full disk or an
interrupt leaves an earlier result as it was. A new folder takes one rename. In an existing folder, the files of the
earlier result, listed in its manifest and unchanged since, move out one by one, the manifest first, and those of the
new result move in, the manifest last: a folder without a manifest, with a staging folder inside, is one whose
replacement was interrupted, and the next run restores the earlier result.

Only listed and unchanged files are ever replaced. Files that the user added, edited or replaced belong to the user.
"""

import hashlib
import json
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

from sionna_radar.execution.checkpoints import FOLDER as PARTS
from sionna_radar.execution.checkpoints import abandoned, in_use, remedy_of, staged
from sionna_radar.foundation.errors import KeptElsewhereError, OutputError

MANIFEST = "manifest.json"
# Costs differ from run to run: these files, and the last columns of this table, are not hashed.
COSTS = "costs.json"
UNHASHED = (COSTS, "runs.parquet")
TABLE, COSTS_COLUMNS = "runs.csv", 2
PROGRAM = "sionna-radar"


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """The files of one result, by their paths inside the folder, with forward slashes.

    kind: file that every result of this kind contains, such as `summary.json`.
    sha256, size_bytes: of each file; "" and 0 for files that differ from run to run, see `UNHASHED` and `TABLE`.
    run: digests of the inputs of the result, see `digests`; empty if not recorded.
    exit_code: of the run.
    """

    kind: str
    sha256: dict[str, str]
    size_bytes: dict[str, int]
    run: dict[str, str] = field(default_factory=dict)
    exit_code: int = 0

    @staticmethod
    def of(folder: Path, kind: str) -> "Manifest":
        """Return the manifest of everything in a folder."""
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        names = [path.relative_to(folder).as_posix() for path in files]
        return Manifest(
            kind=kind,
            sha256=dict(zip(names, map(_sha256, files), strict=True)),
            size_bytes=dict(zip(names, map(_size, files), strict=True)),
        )

    @property
    def names(self) -> list[str]:
        """The paths of all files."""
        return list(self.sha256)

    def holds(self, folder: Path, name: str) -> bool:
        """Return whether a file of a folder is the listed one: a regular file at its path, and unchanged."""
        path = folder / name
        return (
            path.is_file()
            and path.resolve() == folder.resolve() / name  # neither a link nor below one, nor outside the folder
            and _size(path) == self.size_bytes[name]
            and _sha256(path) == self.sha256[name]
        )

    def changed(self, folder: Path) -> list[str]:
        """Return the listed paths whose files have changed; missing files do not count."""
        present = (name for name in self.names if (folder / name).exists() or (folder / name).is_symlink())
        return [name for name in present if not self.holds(folder, name)]

    def text(self) -> str:
        """Return the manifest as JSON."""
        files = {name: {"bytes": self.size_bytes[name], "sha256": self.sha256[name]} for name in self.names}
        run = {"run": self.run, "exit_code": self.exit_code} if self.run else {}
        return json.dumps({"written_by": PROGRAM, "kind": self.kind, "files": files, **run}, indent=2) + "\n"


def read_manifest(path: Path) -> Manifest | None:
    """Return the manifest in a file; None for any other file, or none.

    Raises OutputError if it cannot be read.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except OSError as error:
        message = f"{path} cannot be read ({error.strerror}); check its permissions"
        raise OutputError(message) from error
    except ValueError:
        return None
    try:
        if document["written_by"] != PROGRAM:
            return None
        files = document["files"].items()
        return Manifest(
            kind=str(document["kind"]),
            sha256={name: str(entry["sha256"]) for name, entry in files},
            size_bytes={name: int(entry["bytes"]) for name, entry in files},
            run={str(key): str(digest) for key, digest in document.get("run", {}).items()},
            exit_code=int(document.get("exit_code", 0)),
        )
    except (AttributeError, KeyError, TypeError, ValueError):
        return None


def digests(run: Mapping[str, Any]) -> dict[str, str]:
    """Return a digest of each input of a run."""
    texts = {key: json.dumps(value, sort_keys=True) for key, value in run.items()}
    return {key: hashlib.sha256(text.encode()).hexdigest()[:32] for key, text in texts.items()}


def _sha256(path: Path) -> str:
    if path.name in UNHASHED:
        return ""
    if path.name == TABLE:
        return hashlib.sha256(lasting_columns(path.read_bytes())).hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _size(path: Path) -> int:
    if path.name in UNHASHED:
        return 0
    return len(lasting_columns(path.read_bytes())) if path.name == TABLE else path.stat().st_size


def lasting_columns(table: bytes) -> bytes:
    """Return the text of `TABLE` without its last columns, which hold plain numbers."""
    return b"\n".join(line.rsplit(b",", COSTS_COLUMNS)[0] for line in table.split(b"\n"))


# Inside a staging folder: the new result, the files of the earlier one, and the manifest of the new one.
FRESH, RETIRED, COMING = "fresh", "retired", "coming.json"
MAX_NAMED = 5


def write_folder(directory: Path, marker: str, fill: Callable[[Path], None]) -> list[Path]:
    """Fill a folder by a function, put it in place with its manifest, and return the files written.

    Parameters
    ----------
    directory:
        Output folder; only the files of an earlier result in it are replaced.
    marker:
        File that every result of this kind contains, and that identifies the kind.
    fill:
        Writes the results into the given folder.

    Raises
    ------
    KeptElsewhereError
        The directory holds other files, or a file in it cannot be replaced; the result is saved beside it.
    OutputError
        The results cannot be written at all.

    """
    directory = directory.expanduser().resolve()
    try:
        _clear_abandoned(directory)
        with _missing_parents(directory), staged(_staging_place(directory)) as staging:
            # The staging folder is private to the user; a folder inside it has the usual permissions.
            fresh = staging / FRESH
            fresh.mkdir()
            fill(fresh)
            manifest = Manifest.of(fresh, marker)
            write_text(fresh / MANIFEST, manifest.text())
            _put_in_place(directory, staging, manifest)
    except OutputError:
        raise
    except OSError as error:
        message = f"output = {directory} cannot be written ({error}); {remedy_of(error)}"
        raise OutputError(message) from error
    return sorted(directory / name for name in (*manifest.names, MANIFEST))


def write_study(
    directory: Path,
    marker: str,
    document: dict[str, Any],
    draw: Callable[[Path], object],
    tables: Mapping[str, str] | None = None,
) -> list[Path]:
    """Write the numbers of a study, its tables and its figures as `write_folder` does, and return the files.

    Parameters
    ----------
    directory:
        Output folder; only the files of an earlier result in it are replaced.
    marker:
        File of the numbers, as strict JSON; undefined numbers become null.
    document:
        The numbers.
    draw:
        Draws the figures into the given folder, `figures`.
    tables:
        Texts of additional files, by name.

    Raises
    ------
    OutputError
        As for `write_folder`.

    """

    def fill(folder: Path) -> None:
        for name, text in {marker: strict_json(document), **(tables or {})}.items():
            write_text(folder / name, text)
        draw(folder / "figures")

    return write_folder(directory, marker, fill)


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

    Parameters
    ----------
    directory:
        Output folder.
    run:
        Inputs of the result, as for `note_run`.
    products:
        The key in it of the requested files.

    Raises
    ------
    OutputError
        The folder holds the result of another run.

    """
    manifest = read_manifest(directory.expanduser().resolve() / MANIFEST)
    if manifest is None or not manifest.run:
        return None
    current = digests(run)
    different = [key for key in current if manifest.run.get(key) != current[key]]
    if different == [products] or any(not (directory / name).exists() for name in manifest.names):
        return None
    if different:
        message = (
            f"output = {directory} holds the result of a run with another {', '.join(different)}; "
            "name another folder, or leave out --resume to replace it"
        )
        raise OutputError(message)
    return manifest.exit_code


def costs_json(timing_s: Mapping[str, float], peak_memory_mb: float) -> str:
    """Return the text of `COSTS`: run times, s, and peak memory, MB."""
    return strict_json({"timing_s": dict(timing_s), "peak_memory_mb": peak_memory_mb})


def write_text(path: Path, text: str) -> None:
    """Write text as UTF-8 with line feeds on every system."""
    path.write_text(text, encoding="utf-8", newline="\n")


def strict_json(document: Any) -> str:
    """Return a document as strict JSON text; NaN and infinities become null."""
    return json.dumps(without_nan(document), indent=2, allow_nan=False) + "\n"


def without_nan(value: Any) -> Any:
    """Return nested tables and lists with every NaN and infinity replaced by None."""
    if isinstance(value, dict):
        return {key: without_nan(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# ------------------------------------------------------------------------------------------ checking


def check_output(directory: Path, marker: str) -> Path:
    """Return the resolved directory, or raise an error before any work is done.

    Leftovers of killed runs in it or beside it are removed first, and an earlier result restored.

    Raises
    ------
    OutputError
        It is a file, holds anything but an unchanged earlier result of this kind, or its parent is not a folder or
        cannot be written.

    """
    try:
        directory = directory.expanduser().resolve()
        problem = _obstacle(directory, marker)
    except OutputError:
        raise
    except (OSError, RuntimeError, ValueError) as error:
        problem = f"cannot be reached ({error}); check the path and its permissions"
    if problem:
        message = f"output = {directory} {problem}"
        raise OutputError(message)
    return directory


def _obstacle(directory: Path, marker: str) -> str:
    place = directory if directory.exists() else next(path for path in directory.parents if path.exists())
    if not place.is_dir():
        return "is a file; name a folder" if place == directory else f"cannot be made: {place} is a file; name another"
    _clear_abandoned(directory)
    try:
        # Permission bits do not cover read-only mounts and quotas; creating a folder does.
        tempfile.TemporaryDirectory(dir=place).cleanup()
    except OSError as error:
        return f"cannot be made: {place} is not writable ({error.strerror}); name a folder elsewhere"
    return _unwanted(directory, marker) if place == directory else ""


def _clear_abandoned(directory: Path) -> None:
    """Remove leftovers of killed runs in a folder and beside it, and restore earlier results."""
    for folder in (directory, directory.parent):
        if folder.is_dir():
            for staging in abandoned(folder):
                _put_back(folder, staging)


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


# ------------------------------------------------------------------------------------ putting in place


def _staging_place(directory: Path) -> Path:
    """Return a parent from which renames to the directory stay on one file system."""
    return directory if directory.is_dir() else directory.parent


def _put_in_place(directory: Path, staging: Path, manifest: Manifest) -> None:
    """Move a new result to its folder, or on failure to another one beside it."""
    try:
        if staging.parent == directory:
            _replace(directory, staging, manifest)
        else:
            (staging / FRESH).rename(directory)
    except OSError as error:
        saved = _keep_elsewhere(staging / FRESH, directory)
        reason = error.strerror or str(error)
        message = f"output = {directory} could not be replaced ({reason}); the new result is in {saved}"
        raise KeptElsewhereError(message) from error


def _replace(directory: Path, staging: Path, manifest: Manifest) -> None:
    """Move the files of the earlier result out and those of the new one in; on failure undo all moves."""
    problem = _unwanted(directory, manifest.kind, ignored=staging)
    if problem:
        message = f"it {problem}"
        raise FileExistsError(message)
    earlier = read_manifest(directory / MANIFEST)
    retiring = [MANIFEST, *earlier.names] if earlier else []
    write_text(staging / COMING, manifest.text())
    try:
        for name in retiring:
            if (directory / name).exists():
                _move(directory, name, staging / RETIRED)
        for name in (*manifest.names, MANIFEST):
            if (directory / name).exists() or (directory / name).is_symlink():
                message = f"it holds a {name} that this program did not write"
                raise FileExistsError(message)
            _move(staging / FRESH, name, directory)
    except BaseException:
        _put_back(directory, staging)
        raise
    _drop_empty_folders(directory, retiring)


def _put_back(directory: Path, staging: Path) -> None:
    """Undo an interrupted replacement; do nothing for one not begun or already finished."""
    coming = read_manifest(staging / COMING)
    if coming is None or (directory / MANIFEST).exists():
        return
    for name in coming.names:
        if not (staging / FRESH / name).exists() and coming.holds(directory, name):
            _move(directory, name, staging / FRESH)
    _drop_empty_folders(directory, coming.names)
    retired = staging / RETIRED
    names = [path.relative_to(retired).as_posix() for path in retired.rglob("*") if path.is_file()]
    for name in sorted(names, key=MANIFEST.__eq__):  # the manifest last
        _move(retired, name, directory)


def _move(source: Path, name: str, target: Path) -> None:
    (target / name).parent.mkdir(parents=True, exist_ok=True)
    (source / name).replace(target / name)


def _drop_empty_folders(directory: Path, names: list[str]) -> None:
    """Remove the folders of some files if they are empty."""
    folders = {parent for name in names for parent in (directory / name).parents if parent.is_relative_to(directory)}
    for folder in sorted(folders - {directory}, reverse=True):
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
    message = f"output = {directory} cannot be written, nor any folder beside it; the result is lost"
    raise OutputError(message)


@contextmanager
def _missing_parents(directory: Path) -> Iterator[None]:
    """Create the parents of a directory, and remove them again on failure."""
    missing = [path for path in directory.parents if not path.exists()]
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for path in missing:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()
        raise


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

        Raises
        ------
        OutputError
            It is a folder, a file of another origin or edited since, or its folder cannot be written.

        """
        try:
            path = path.expanduser().resolve()
            problem = self._obstacle(path)
        except (OSError, RuntimeError, ValueError) as error:
            problem = f"cannot be written ({error}); name another file"
        if problem:
            message = f"output = {path} {problem}"
            raise OutputError(message)
        return path

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
            message = f"output = {path} cannot be written ({error.strerror}); name another file"
            raise OutputError(message) from error
        return path

    def _signed(self, text: str) -> str:
        digest = hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()
        line = f"{self._mark}{digest}{self.after}\n"
        return text + line if self.at_end else line + text

    @property
    def _mark(self) -> str:
        words = f"Written by sionna-radar {self.command}, which replaces this file only unedited. SHA-256 of the rest: "
        return self.before + words

    def _obstacle(self, path: Path) -> str:
        if path.is_dir():
            return "is a folder; name a file"
        if not path.parent.is_dir():
            return f"cannot be written: there is no folder {path.parent}; make it or name another file"
        if not path.exists():
            return ""
        if not path.is_file():
            return "is no regular file; name another file"
        content = path.read_bytes().decode("utf-8", "replace")
        text = content.rpartition(self._mark)[0] if self.at_end else content.partition("\n")[2]
        if content != self._signed(text):
            return f"exists, and was not written by {self.command} or was edited since; name another file"
        return ""
