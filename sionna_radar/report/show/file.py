"""The file of a page: replaced only if this program wrote it and it was not changed since."""

import hashlib
from pathlib import Path

from sionna_radar.foundation.errors import OutputError
from sionna_radar.foundation.staging import staged
from sionna_radar.report.folder import write_text

# Its last line: a browser does not mind what follows the document.
SIGNATURE = "<!-- Written by sionna-radar show, which replaces this file only unchanged. SHA-256 of the rest: "
END = " -->\n"


def check_page_file(path: Path) -> Path:
    """Return the resolved path, or refuse it before any work is done.

    Raises
    ------
    OutputError
        It is a folder, a file that `show` did not write or that was changed since, or its folder does not exist.

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


def write_page_file(path: Path, text: str) -> Path:
    """Write a page to a file, completely or not at all, and return the file.

    Raises OutputError as `check_page_file` does.
    """
    path = check_page_file(path)
    try:
        with staged(path.parent) as staging:
            write_text(staging / path.name, f"{text}{SIGNATURE}{_sha256(text)}{END}")
            (staging / path.name).replace(path)
    except OSError as error:
        message = f"output = {path} cannot be written ({error.strerror}); name another file"
        raise OutputError(message) from error
    return path


def _obstacle(path: Path) -> str:
    if path.is_dir():
        return "is a folder; name a file"
    if not path.parent.is_dir():
        return f"cannot be written: there is no folder {path.parent}; make it or name another file"
    if not path.exists():
        return ""
    if not path.is_file():
        return "is no regular file; name another file"
    text, mark, signed = path.read_bytes().decode("utf-8", "replace").rpartition(SIGNATURE)
    if not mark or signed != f"{_sha256(text)}{END}":
        return "exists, and was not written by show or was changed since; name another file"
    return ""


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()
