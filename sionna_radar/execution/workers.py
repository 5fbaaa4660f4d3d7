"""Independent tasks, run in this process or by workers on this machine or others.

Tasks are JSON documents and results are bytes, the content of a checkpoint. A worker needs only the same version of
the package, and returns the same bits as this process would.

`versions` returns the versions of Python and of the packages that affect the bits of a result.
"""

import builtins
import json
import logging
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Protocol, runtime_checkable

from sionna_radar.foundation import errors
from sionna_radar.foundation.errors import Problem, RadarError, ScenarioError, WorkerError, one_line
from sionna_radar.foundation.interrupts import raise_received

logger = logging.getLogger("sionna_radar")

Task = Mapping[str, Any]
# Key of the payload shared by all tasks.
SHARED = "shared"
# A module-level function, sent to workers by name; it returns a result as bytes.
Work = Callable[[Task], bytes]


@dataclass(frozen=True, kw_only=True)
class Failure:
    """Why a task has no result.

    kind: name of the error's class; text: what is wrong, in one line.
    problems, source: of a ScenarioError.
    cause: the error itself, if it was raised in this process.
    """

    kind: str
    text: str
    problems: tuple[tuple[str, str], ...] = ()
    source: str = ""
    cause: Exception | None = field(default=None, repr=False, compare=False)

    @staticmethod
    def of(error: Exception) -> "Failure":
        """Return the failure that an exception describes."""
        problems = error.problems if isinstance(error, ScenarioError) else ()
        return Failure(
            kind=type(error).__name__,
            text=one_line(error),
            problems=tuple((problem.field, problem.message) for problem in problems),
            source=getattr(error, "source", ""),
            cause=error,
        )

    def document(self) -> dict[str, Any]:
        """Return it as a JSON document, without its cause."""
        return {"kind": self.kind, "text": self.text, "problems": self.problems, "source": self.source}

    @staticmethod
    def of_document(document: Mapping[str, Any]) -> "Failure":
        """Return the failure of a document."""
        return Failure(**{**document, "problems": tuple((name, text) for name, text in document["problems"])})

    def error(self) -> Exception:
        """Return the exception to raise: of the original class if it is ours or a built-in, otherwise WorkerError."""
        if self.cause is not None:
            return self.cause
        if self.kind == ScenarioError.__name__:
            return ScenarioError([Problem(*problem) for problem in self.problems], self.source)
        kind = getattr(errors, self.kind, None) or getattr(builtins, self.kind, None)
        if isinstance(kind, type) and issubclass(kind, RadarError | MemoryError | ValueError):
            return kind(self.text)
        return WorkerError(f"{self.kind}: {self.text}")


@runtime_checkable
class Workers(Protocol):
    """Runs tasks."""

    @property
    def count(self) -> int:
        """Number of tasks run at once; 0 if this process runs them itself."""

    def each(self, work: Work, tasks: Sequence[Task], shared: Any = None) -> Iterator[tuple[int, bytes | Failure]]:
        """Yield index and result or failure of each task as it finishes.

        `shared` is an entry of every task; for workers it is bytes, sent once to each.
        """


class InProcess:
    """Run tasks one after another in this process."""

    count = 0

    def each(self, work: Work, tasks: Sequence[Task], shared: Any = None) -> Iterator[tuple[int, bytes | Failure]]:
        """Yield the results in the order of the tasks."""
        for number, task in enumerate(tasks):
            yield number, attempt(work, {**task, SHARED: shared})


def attempt(work: Work, task: Task) -> bytes | Failure:
    """Return the result of a task, or its failure."""
    try:
        return work(task)
    except Exception as error:
        # One failed task must not discard the results of the others.
        raise_received()
        logger.debug("a task failed", exc_info=True)
        return Failure.of(error)


def document_bytes(document: Any) -> bytes:
    """Return a JSON document as bytes, its numbers exact."""
    return json.dumps(document).encode()


def document_of(content: bytes) -> Any:
    """Return the JSON document of some bytes."""
    return json.loads(content)


PACKAGES = ("sionna-radar", "sionna-rt", "mitsuba", "drjit", "numpy", "scipy", "finufft")


def versions() -> dict[str, str | None]:
    """Return the versions of Python and of the packages that affect the numbers; None if not installed."""
    # Package metadata is read without loading Mitsuba and its LLVM.
    return {"python": platform.python_version()} | {name: _version(name) for name in PACKAGES}


@cache
def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
