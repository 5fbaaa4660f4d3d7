"""Folders of results, written beside and put in place by renames.

A result is written to a staging folder, so that a failure, a full disk or an interrupt leaves an earlier result as it
was. A new folder takes one rename. In an existing folder the files of the earlier result go to a backup one by one, the
manifest first, and those of the new result come in, the manifest last:

    folder/manifest.json, a, b           the earlier result
    folder/.sionna-radar-*/new/          the new result with its manifest, which is the journal
    folder/.sionna-radar-*/backup/       the earlier result, while it is replaced

A folder without a manifest but with a journal in it is one whose replacement was interrupted. The moves are undone by
the same run, or by the next one if it was killed. Only files that a manifest lists and that are unchanged since are
ever replaced: what the user added, edited or replaced belongs to the user.
"""

import os
import tempfile
from collections.abc import Callable, Iterable
from itertools import count
from pathlib import Path

from sionna_radar.execution.checkpoints import FOLDER as PARTS
from sionna_radar.execution.staging import abandoned, in_use, remedy_of, staged
from sionna_radar.foundation.errors import KeptElsewhereError, OutputError
from sionna_radar.report.files.contents import write_text
from sionna_radar.report.files.manifest import MANIFEST, Manifest, read_manifest

# Inside a staging folder: the new result, and the files of the earlier one.
NEW, BACKUP = "new", "backup"
MAX_NAMED = 5


def check_output(directory: Path, marker: str) -> Path:
    """Return the resolved directory, cleared of leftovers of killed runs, before any work is done.

    Raises OutputError if it is a file, holds anything but an unchanged earlier result of this kind, or its parent is
        not a folder or cannot be written.
    """
    return check_path(directory, lambda path: _obstacle(path, marker))


def check_path(path: Path, obstacle: Callable[[Path], str]) -> Path:
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
    """Return why an existing folder, this run's staging folder `ignored`, cannot take a result; "" if it can."""
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

    marker: file that every result of this kind contains, and that identifies the kind.
    Raises KeptElsewhereError if the directory holds other files, or a file in it cannot be replaced (the result is then
        saved beside it), and OutputError if the results cannot be written at all.
    """
    directory = directory.expanduser().resolve()
    try:
        _clear_abandoned(directory)
        directory.parent.mkdir(parents=True, exist_ok=True)
        # Renames to the directory must stay on one file system.
        with staged(directory if directory.is_dir() else directory.parent) as staging:
            # The staging folder is private to the user; a folder inside it has the usual permissions.
            new = staging / NEW
            new.mkdir()
            fill(new)
            manifest = Manifest.of(new, marker)
            write_text(new / MANIFEST, manifest.text())
            try:
                if staging.parent == directory:
                    _replace(directory, staging, manifest)
                else:
                    new.rename(directory)
            except OSError as error:
                saved = _keep_elsewhere(new, directory)
                reason = error.strerror or str(error)
                message = f"output = {directory} could not be replaced ({reason}); the new result is in {saved}"
                raise KeptElsewhereError(message) from error
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"output = {directory} cannot be written ({error}); {remedy_of(error)}") from error
    return sorted(directory / name for name in (*manifest.files, MANIFEST))


def _replace(directory: Path, staging: Path, manifest: Manifest) -> None:
    """Move the files of the earlier result to the backup and those of the new one in; on failure undo all moves."""
    problem = _unwanted(directory, manifest.kind, ignored=staging)
    if problem:
        raise FileExistsError(f"it {problem}")
    for parent in {parent for name in manifest.files for parent in Path(name).parents} - {Path()}:
        if (directory / parent).is_symlink():
            raise FileExistsError(f"its {parent.as_posix()} is a link to another folder")
    earlier = read_manifest(directory / MANIFEST)
    replaced = [name for name in (MANIFEST, *earlier.files) if (directory / name).exists()] if earlier else []
    try:
        for name in replaced:
            _move(directory, name, staging / BACKUP)
        for name in (*manifest.files, MANIFEST):
            if os.path.lexists(directory / name):
                raise FileExistsError(f"it holds a {name} that this program did not write")
            _move(staging / NEW, name, directory)
    except BaseException:
        _undo(directory, staging)
        raise
    _drop_empty_folders(directory, replaced)


def _undo(directory: Path, staging: Path) -> None:
    """Undo an interrupted replacement; do nothing for one not begun or already finished."""
    new, backup = staging / NEW, staging / BACKUP
    journal = read_manifest(new / MANIFEST)
    if journal is None or (directory / MANIFEST).exists():
        return
    for name in journal.files:
        if not (new / name).exists() and journal.holds(directory, name):
            _move(directory, name, new)
    _drop_empty_folders(directory, journal.files)
    names = [path.relative_to(backup).as_posix() for path in backup.rglob("*") if path.is_file()]
    for name in sorted(names, key=MANIFEST.__eq__):  # the manifest last
        if not os.path.lexists(directory / name):  # else the user has edited the new file since
            _move(backup, name, directory)


def _clear_abandoned(directory: Path) -> None:
    """Remove leftovers of killed runs in a folder and beside it, and restore earlier results."""
    for folder in (directory, directory.parent):
        for staging in abandoned(folder):
            _undo(folder, staging)


def _move(source: Path, name: str, target: Path) -> None:
    (target / name).parent.mkdir(parents=True, exist_ok=True)
    (source / name).replace(target / name)


def _drop_empty_folders(directory: Path, names: Iterable[str]) -> None:
    folders = {directory / parent for name in names for parent in Path(name).parents} - {directory}
    for folder in sorted(folders, reverse=True):
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def _keep_elsewhere(new: Path, directory: Path) -> Path:
    """Move a result to a free name beside its folder, or inside it if that is impossible."""
    for parent in (directory.parent, directory):
        free = next(path for n in count(2) if not (path := parent / f"{directory.name}-{n}").exists())
        try:
            return new.rename(free)
        except OSError:
            continue
    raise OutputError(f"output = {directory} cannot be written, nor any folder beside it; the result is lost")
