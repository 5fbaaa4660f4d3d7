"""Manifest of a folder of results: the files that this program wrote, each with its size and hash.

Only a listed and unchanged file may ever be replaced. A file that the user has added, edited or put
in place of ours belongs to the user.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sionna_radar.foundation.errors import OutputError

MANIFEST = "manifest.json"
# What a run took differs from run to run: these files, and the last columns of this table, are not hashed.
COSTS = "costs.json"
UNHASHED = (COSTS, "runs.parquet")
TABLE, COSTS_COLUMNS = "runs.csv", 2
PROGRAM = "sionna-radar"


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """The files of one result, by their paths inside the folder, with forward slashes.

    kind: file that every result of this kind contains, such as `summary.json`.
    sha256, size_bytes: of each file; "" and 0 for one that no two runs write alike, see `UNHASHED` and `TABLE`.
    run: digests of what the result depends on, see `digests`; empty where that was not noted.
    exit_code: with which the run ended.
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
        """Return whether a file of a folder is the one listed: present, a regular file at its path, and unchanged."""
        path = folder / name
        return (
            path.is_file()
            and path.resolve() == folder.resolve() / name  # neither a link nor below one, nor outside the folder
            and _size(path) == self.size_bytes[name]
            and _sha256(path) == self.sha256[name]
        )

    def changed(self, folder: Path) -> list[str]:
        """Return the listed paths whose files have changed; missing files do not count."""
        there = (name for name in self.names if (folder / name).exists() or (folder / name).is_symlink())
        return [name for name in there if not self.holds(folder, name)]

    def text(self) -> str:
        """Return the manifest as JSON."""
        files = {name: {"bytes": self.size_bytes[name], "sha256": self.sha256[name]} for name in self.names}
        run = {"run": self.run, "exit_code": self.exit_code} if self.run else {}
        return json.dumps({"written_by": PROGRAM, "kind": self.kind, "files": files, **run}, indent=2) + "\n"


def read_manifest(path: Path) -> Manifest | None:
    """Return the manifest in a file; None if there is none of ours.

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
    """Return a digest of each entry of what a run depends on."""
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
