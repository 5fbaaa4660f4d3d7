"""Folders of results, written whole or not at all.

Everything is written to a temporary folder beside the destination and moved into place by a rename, so a
failure, a full disk or an interrupt leaves an earlier result as it was.
"""

import json
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sionna_radar.errors import OutputError


def write_folder(directory: Path, marker: str, fill: Callable[[Path], None]) -> list[Path]:
    """Let a function fill a folder, put it in place, and return the files in it.

    Parameters
    ----------
    directory:
        Where the results go; an earlier result there is replaced as a whole.
    marker:
        File that every result of this kind holds, and by which an earlier one is known.
    fill:
        Writes the results into the folder it is given.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written.

    """
    directory = check_output(directory, marker)
    try:
        with (
            _missing_parents(directory),
            tempfile.TemporaryDirectory(
                prefix=f".{directory.name}.", dir=directory.parent, ignore_cleanup_errors=True
            ) as staging,
        ):
            # The staging folder itself is private to the user; a folder made inside it has usual permissions.
            fresh = Path(staging) / "fresh"
            fresh.mkdir()
            fill(fresh)
            _move_into_place(fresh, directory, retired=Path(staging) / "retired")
    except OSError as error:
        message = f"output = {directory} cannot be written ({error}); free some space or name another folder"
        raise OutputError(message) from error
    return sorted(path for path in directory.rglob("*") if path.is_file())


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
        Where the results go; an earlier result there is replaced as a whole.
    marker:
        File of the numbers, as strict JSON; a number that does not exist becomes null.
    document:
        The numbers.
    draw:
        Draws the figures into the folder it is given, `figures`.
    tables:
        Texts of further files by their names.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written.

    """

    def fill(folder: Path) -> None:
        for name, text in {marker: strict_json(document), **(tables or {})}.items():
            write_text(folder / name, text)
        draw(folder / "figures")

    return write_folder(directory, marker, fill)


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


def check_output(directory: Path, marker: str) -> Path:
    """Return the resolved directory, or refuse it before any work is lost on it.

    Raises
    ------
    OutputError
        It is a file, a mount point, or holds something other than an earlier result, or the place that it
        would be made in is no folder or cannot be written.

    """
    try:
        directory = directory.expanduser().resolve()
        problem = _obstacle(directory, marker)
    except (OSError, RuntimeError) as error:
        problem = f"cannot be reached ({error}); check the path and its permissions"
    if problem:
        message = f"output = {directory} {problem}"
        raise OutputError(message)
    return directory


def _obstacle(directory: Path, marker: str) -> str:
    if directory.exists():
        if not directory.is_dir():
            return "is a file; name a folder"
        if directory.is_mount():
            return "is a mount point and cannot be replaced; name a folder inside it"
        if any(directory.iterdir()) and not (directory / marker).is_file():
            return (
                f"is not empty and holds no earlier result (no {marker}); name a new or empty folder, "
                "or empty this one"
            )
    parent = next(path for path in directory.parents if path.exists())
    if not parent.is_dir():
        return f"cannot be made: {parent} is a file; name a folder elsewhere"
    try:
        # Permission bits do not tell of read-only mounts and quotas; making a folder does.
        tempfile.TemporaryDirectory(prefix=f".{directory.name}.", dir=parent).cleanup()
    except OSError as error:
        return f"cannot be made: {parent} is not writable ({error.strerror}); name a folder elsewhere"
    return ""


@contextmanager
def _missing_parents(directory: Path) -> Iterator[None]:
    """Make the parents of a directory, and take them away again on failure."""
    missing = [path for path in directory.parents if not path.exists()]
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for path in missing:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()
        raise


def _move_into_place(fresh: Path, directory: Path, retired: Path) -> None:
    """Rename the fresh result to its place; the earlier one, if any, ends as `retired`."""
    earlier = directory.exists()
    if earlier:
        directory.rename(retired)
    try:
        fresh.rename(directory)
    except BaseException:
        if earlier:
            retired.rename(directory)
        raise
