"""Safe reading of user files (text, TOML, CSV numbers) of bounded size, and the permission to use the network.

A pipe may never end, a device has no size, and a path may contain characters that no file system accepts: all end
in one `InputFileError` that names what was requested.

This process may reach the network only if the user allows it.
"""

import copy
import csv
import errno
import math
import os
import re
import stat
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from sionna_radar.foundation.errors import InputFileError

MAX_TEXT_BYTES = 10_000_000
LONGEST_SHOWN = 120
# Deeper than any table of a scenario; TOML's parser and pydantic recurse once or more for each level.
DEEPEST_NESTING = 32
# Range of integers guaranteed by TOML.
MIN_WHOLE, MAX_WHOLE = -(2**63), 2**63 - 1


def shown(value: object) -> str:
    """Return a value as shown in error messages: on one line, printable anywhere, and not too long."""
    text = str(value) if isinstance(value, os.PathLike) else repr(value)
    text = text.encode("utf-8", "backslashreplace").decode("utf-8")
    text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
    if len(text) > LONGEST_SHOWN:
        text = f"{text[: LONGEST_SHOWN // 2]}...{text[-LONGEST_SHOWN // 4 :]} ({len(text)} characters)"
    return text


def compact(number: float | int) -> str:
    """Return a number as shown in error messages: six digits, and exponents without padding (1e7)."""
    return re.sub(r"e([+-])0*", lambda match: "e" + match[1].strip("+"), f"{number:g}")


def regular_file(path: Path, name: str, remedy: str, most_bytes: int = MAX_TEXT_BYTES) -> int:
    """Return the size of a regular file in bytes; InputFileError for none, a larger one, or an invalid path.

    name, remedy: begin and end the message: what requested the file, and what to give instead.
    """
    try:
        status = path.stat()
    except (ValueError, OSError) as error:  # ValueError: a NUL, or characters that the file system cannot encode
        raise InputFileError(f"{name} {shown(path)} {why_not(error)}; {remedy}") from error
    if not stat.S_ISREG(status.st_mode):
        kind = "a directory" if stat.S_ISDIR(status.st_mode) else "a device, pipe or socket"
        raise InputFileError(f"{name} {shown(path)} is {kind}, not a regular file; {remedy}")
    if status.st_size > most_bytes:
        raise InputFileError(f"{name} {shown(path)} has {status.st_size:,} bytes, more than {most_bytes:,}; {remedy}")
    return status.st_size


@contextmanager
def readable(path: Path, name: str) -> Iterator[None]:
    """Raise InputFileError where the system refuses to read a file; name: what requested it."""
    try:
        yield
    except OSError as error:
        message = f"{name} {shown(path)} cannot be read ({error.strerror}); check its permissions"
        raise InputFileError(message) from error


def read_bytes(path: Path, name: str, remedy: str, most_bytes: int = MAX_TEXT_BYTES) -> bytes:
    """Return the content of a file. Raises InputFileError as `regular_file` does, and if the file cannot be read."""
    regular_file(path, name, remedy, most_bytes)
    with readable(path, name):
        return path.read_bytes()


def read_text(path: Path, name: str, remedy: str) -> str:
    """Return the text of a UTF-8 file, each end of a line as one character; InputFileError for any other file."""
    try:
        return read_bytes(path, name, remedy).decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise InputFileError(f"{name} {shown(path)} is not text; save it in UTF-8") from error


def read_numbers(
    path: Path,
    name: str,
    columns: Mapping[str, float | None],
    remedy: str,
    further: Literal["refused", "ignored"] = "refused",
) -> tuple[list[int], list[tuple[float, ...]]]:
    """Return the columns of a CSV table of finite numbers, in the order of `columns`, and the line of each row.

    Lines starting with # are comments. Raises InputFileError, naming the line, for any other file.

    columns: by name, with the value of a column that is left out; None for a required one.
    further: what becomes of other columns.
    """
    lines = list(enumerate(read_text(path, name, remedy).splitlines(), start=1))
    (first, head), *body = [(n, line) for n, line in lines if line.strip() and line.lstrip()[0] != "#"] or [(1, "")]
    header = [cell.lower() for cell in _cells(head)]
    required = {column for column, default in columns.items() if default is None}
    unknown = len(set(header) - columns.keys()) if further == "refused" else 0
    if unknown or not required <= set(header) or any(header.count(column) > 1 for column in columns):
        raise InputFileError(
            f"{name} {shown(path)}: line {first} reads {shown(head.strip())}, and is not a header of column names; "
            f"{remedy}"
        )
    absent: dict[str, Any] = {column: default for column, default in columns.items() if column not in header}
    rows = []
    for number, line in body:
        row = absent | dict(zip(header, cells := _cells(line), strict=False))
        try:
            values = [float(row[column]) for column in columns]
        except (ValueError, KeyError):
            values = [math.nan]
        if not all(map(math.isfinite, values)) or (further == "refused" and len(cells) > len(header)):
            message = f"{name} {shown(path)}: line {number} reads {shown(line.strip())}; give finite numbers"
            raise InputFileError(message)
        rows.append(values)
    if not rows:
        raise InputFileError(f"{name} {shown(path)}: has no row of numbers; {remedy}")
    return [number for number, _ in body], list(zip(*rows, strict=True))


def _cells(line: str) -> list[str]:
    """Return the cells of a line of a CSV table; none if it is not one."""
    try:
        return [cell.strip() for cell in next(csv.reader([line]), [])]
    except csv.Error:
        return []


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

    Raises ValueError for no TOML, one nested too deeply for a scenario, or a whole number beyond 64 bits.
    """
    return copy.deepcopy(_parsed_toml(text))


@lru_cache(maxsize=16)  # a search reads the scenario that it varies thousands of times
def _parsed_toml(text: str) -> dict[str, Any]:
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise ValueError("tables or lists are nested too deeply") from None
    except ValueError as error:
        if isinstance(error, tomllib.TOMLDecodeError):
            raise
        raise ValueError("a whole number has thousands of digits") from error
    level: list[Any] = [data]
    for _ in range(DEEPEST_NESTING):
        inner = [v for node in level for v in (node.values() if isinstance(node, dict) else node)]
        for value in inner:
            if isinstance(value, int) and not MIN_WHOLE <= value <= MAX_WHOLE:
                raise ValueError(f"the whole number {shown(value)} does not fit 64 bits")
        level = [value for value in inner if isinstance(value, dict | list)]
        if not level:
            return data
    raise ValueError(f"tables or lists are nested more than {DEEPEST_NESTING} deep")


def is_file(path: Path) -> bool:
    """Return True if a path leads to a file; False for one that no file system takes, at which `Path.is_file` fails."""
    return os.path.isfile(path)  # noqa: PTH113


def is_folder(path: Path) -> bool:
    """Return True if a path leads to a folder; see `is_file`."""
    return os.path.isdir(path)  # noqa: PTH112


def why_not(error: ValueError | OSError) -> str:
    """Return the reason that a path does not lead to a file."""
    if isinstance(error, ValueError):
        return "contains characters that no path can contain"
    match error.errno:
        case errno.ENOENT | errno.ENOTDIR:
            return "does not exist"
        case errno.ELOOP:
            return "is a loop of symbolic links"
        case errno.ENAMETOOLONG:
            return "is too long for a path"
    return f"cannot be reached ({error.strerror})"


# Addresses, and the file systems behind which GDAL reaches for them.
ADDRESS = re.compile(r"(?:[a-z][a-z0-9+.-]{1,15}://|/vsi)", re.IGNORECASE)

_allowed: ContextVar[bool] = ContextVar("network_allowed", default=False)


def is_address(text: str) -> bool:
    """Whether a path is an address on the network."""
    return bool(ADDRESS.match(text))


def network_allowed() -> bool:
    """Whether the user has allowed the network."""
    return _allowed.get()


@contextmanager
def allow_network() -> Iterator[None]:
    """Allow the network inside a `with` block, as `--allow-network` does for a command.

    Returns
    -------
    A context manager; the network is allowed inside its `with` block.

    Examples
    --------
    >>> far = {"terrain": {"kind": "raster", "path": "https://example.org/dem.tif"}}
    >>> scenario = load_scenario("hills", far)
    >>> with allow_network():  # prepare(scenario) would read the address here
    ...     str(scenario.terrain.path)
    'https://example.org/dem.tif'
    """
    token = _allowed.set(True)
    try:
        yield
    finally:
        _allowed.reset(token)
