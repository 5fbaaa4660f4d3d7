"""A single file that a command writes: replaced only if this program wrote it and it was not edited since."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from sionna_radar.foundation.errors import OutputError
from sionna_radar.foundation.staging import staged
from sionna_radar.report.folder import write_text


@dataclass(frozen=True, kw_only=True)
class SignedFile:
    """The files of one command, each with a line that signs the rest.

    command: which writes them.
    before, after: what makes a comment of the line.
    at_end: whether the line is the last, not the first.
    """

    command: str
    before: str
    after: str = ""
    at_end: bool = False

    def check(self, path: Path) -> Path:
        """Return the resolved path, or refuse it before any work is done.

        Raises
        ------
        OutputError
            It is a folder, a file that the command did not write or that was edited since, or its folder cannot be
            written.

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
