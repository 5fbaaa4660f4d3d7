"""Independent tasks, done one after another here, or by workers: other processes, on this machine or on many.

A task and its result travel as documents: a task as JSON, its result as the bytes that are kept as a finished part.
So a worker needs no more than the same version of the program, and what it returns is what this process would have
made, bit for bit.

`versions` gives the versions of Python and of the packages that decide the bits of a result.
"""

import builtins
import json
import logging
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Protocol, runtime_checkable

from sionna_radar.foundation import errors
from sionna_radar.foundation.errors import Problem, RadarError, ScenarioError, WorkerError, one_line
from sionna_radar.foundation.interrupts import raise_received

logger = logging.getLogger("sionna_radar")

Task = Mapping[str, Any]
# Name of the entry of a task that is the same in all of them.
SHARED = "shared"
# A function of a module, by whose name workers find it: it returns the bytes of a result.
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
        """Return the failure that an error is."""
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
    def of_document(found: Mapping[str, Any]) -> "Failure":
        """Return the failure of a document."""
        return Failure(**{**found, "problems": tuple((name, text) for name, text in found["problems"])})

    def error(self) -> Exception:
        """Return it as an error to raise: of its own class, if that is the program's or Python's, else WorkerError."""
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
    """What does tasks.

    count: how many it does at once; 0 if this process does them itself.
    """

    @property
    def count(self) -> int:
        """How many tasks are done at once; 0 if this process does them itself."""
        ...

    def each(self, work: Work, tasks: Sequence[Task], shared: Any = None) -> Iterator[tuple[int, bytes | Failure]]:
        """Yield the number of each task, and its result or why it has none, as they finish.

        What is `shared` is an entry of every task: for workers bytes, which each is sent once.
        """
        ...


class InProcess:
    """Does one task after another in this process."""

    count = 0

    def each(self, work: Work, tasks: Sequence[Task], shared: Any = None) -> Iterator[tuple[int, bytes | Failure]]:
        """Yield the result of each task in their order."""
        for number, task in enumerate(tasks):
            yield number, attempt(work, {**task, SHARED: shared})


def attempt(work: Work, task: Task) -> bytes | Failure:
    """Return the result of a task, or why it has none."""
    try:
        return work(task)
    except Exception as error:
        # Hours of other tasks must not be lost by one, whatever it fails of.
        raise_received()
        logger.debug("a task failed", exc_info=True)
        return Failure.of(error)


def name_of(work: Work) -> str:
    """Return the name by which workers find a function."""
    return f"{work.__module__}:{work.__qualname__}"


def named(name: str) -> Work:
    """Return the function of a name."""
    module, _, function = name.partition(":")
    found: Work = getattr(import_module(module), function)
    return found


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


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
