"""The scenario file of a plan: replaced only if this program wrote it and it was not edited since."""

import hashlib
from pathlib import Path

from sionna_radar.foundation.errors import OutputError
from sionna_radar.foundation.staging import staged
from sionna_radar.report.folder import write_text

SIGNATURE = "# Written by sionna-radar plan, which replaces this file only unedited. SHA-256 of the rest: "


def check_plan_file(path: Path) -> Path:
    """Return the resolved path, or refuse it before any work is done.

    Raises
    ------
    OutputError
        It is a folder, a file that `plan` did not write or that was edited since, or its folder cannot be
        written.

    """
    try:
        path = path.expanduser().resolve()
        problem = _obstacle(path)
    except (OSError, RuntimeError, ValueError) as error:
        problem = f"cannot be written ({error}); name another file"
    if problem:
        message = f"output = {path} {problem}"
        raise OutputError(message)
    return path


def write_plan_file(path: Path, text: str) -> None:
    """Write a scenario to a file, completely or not at all.

    Raises OutputError as `check_plan_file` does.
    """
    path = check_plan_file(path)
    try:
        with staged(path.parent) as staging:
            write_text(staging / path.name, f"{SIGNATURE}{_sha256(text)}\n{text}")
            (staging / path.name).replace(path)
    except OSError as error:
        message = f"output = {path} cannot be written ({error.strerror}); name another file"
        raise OutputError(message) from error


def _obstacle(path: Path) -> str:
    if path.is_dir():
        return "is a folder; name a file"
    if not path.parent.is_dir():
        return f"cannot be written: there is no folder {path.parent}; make it or name another file"
    if not path.exists():
        return ""
    first, _, rest = path.read_bytes().decode("utf-8", "replace").partition("\n")
    if first != f"{SIGNATURE}{_sha256(rest)}":
        return "exists, and was not written by plan or was edited since; name another file"
    return ""


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()
