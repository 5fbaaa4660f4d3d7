"""The manifest of a folder of results: what the program wrote into it, of which run, with which exit code."""

import errno
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sionna_radar.execution.staging import staged
from sionna_radar.foundation.errors import OutputError
from sionna_radar.report.files.contents import COSTS, write_text

MANIFEST = "manifest.json"
# Costs differ from run to run: these files, and the last columns of this table, are not hashed.
UNHASHED = (COSTS, "runs.parquet")
TABLE, COSTS_COLUMNS = "runs.csv", 2
PROGRAM = "sionna-radar"


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
    """Return the manifest in a file; None for anything else, or none. Raises OSError if it cannot be read."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        manifest = Manifest(
            kind=str(document["kind"]),
            files={name: (int(entry["bytes"]), str(entry["sha256"])) for name, entry in document["files"].items()},
            run={str(key): str(digest) for key, digest in document.get("run", {}).items()},
            exit_code=int(document.get("exit_code", 0)),
        )
        return manifest if document["written_by"] == PROGRAM else None
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG):
            return None
        raise
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
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


def digests(run: Mapping[str, Any]) -> dict[str, str]:
    """Return a digest of each input of a run."""
    texts = {key: json.dumps(value, sort_keys=True) for key, value in run.items()}
    return {key: hashlib.sha256(text.encode()).hexdigest()[:32] for key, text in texts.items()}


def note_run(directory: Path, run: Mapping[str, Any], exit_code: int) -> None:
    """Record in the manifest of a finished result its run and exit code."""
    _rewrite(directory.expanduser().resolve(), run=digests(run), exit_code=exit_code)


def keep_run(directory: Path, earlier: Manifest) -> None:
    """Record in the manifest of a folder that the result is still that of an earlier manifest's run."""
    _rewrite(directory, run=earlier.run, exit_code=earlier.exit_code)


def _rewrite(directory: Path, **changes: Any) -> None:
    manifest = read_manifest(directory / MANIFEST)
    if manifest is None:
        return
    with staged(directory) as staging:
        write_text(staging / MANIFEST, replace(manifest, **changes).text())
        (staging / MANIFEST).replace(directory / MANIFEST)


def finished_as(directory: Path, run: Mapping[str, Any], products: str) -> int | None:
    """Return the exit code of the run whose result is in a folder; None without one, or for other products.

    products: key of the requested files in the inputs of a run; see `note_run`.
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
