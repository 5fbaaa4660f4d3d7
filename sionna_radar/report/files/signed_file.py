"""Single files, each with a line that signs the rest: what a user has edited is not overwritten."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from sionna_radar.execution.staging import staged
from sionna_radar.foundation.errors import OutputError
from sionna_radar.report.files.contents import write_text
from sionna_radar.report.files.folder import check_path


@dataclass(frozen=True, kw_only=True)
class SignedFile:
    """The files of one command, each with a line that signs the rest.

    before, after: comment delimiters of the line. at_end: True if it is the last, not the first.
    """

    command: str
    before: str
    after: str = ""
    at_end: bool = False

    def check(self, path: Path) -> Path:
        """Return the resolved path; OutputError for a folder, a file of another origin or edited, or no such folder."""
        return check_path(path, self._obstacle)

    def write(self, path: Path, text: str) -> Path:
        """Write text to a file, completely or not at all, and return the file. Raises OutputError as `check` does."""
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
