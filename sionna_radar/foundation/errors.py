"""Errors that a user can cause; each names the field, the value and the remedy."""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass


class RadarError(Exception):
    """Base of every error this package raises on purpose.

    Examples
    --------
    >>> try:
    ...     load_scenario("no_such_scene")
    ... except RadarError as error:
    ...     print(type(error).__name__)
    InputFileError
    """


@dataclass(frozen=True)
class Problem:
    """One problem of an input: the dotted key of the field, what is wrong, and the remedy."""

    field: str
    message: str

    def __str__(self) -> str:
        return f"{self.field}: {self.message}"


# Name of a scenario without a file in errors.
UNNAMED = "scenario"


class ScenarioError(RadarError, ValueError):
    """A scenario that cannot be simulated, with every problem found in it.

    problems: each with the dotted key of its field, what is wrong, and the remedy.
    source: where the scenario came from.

    Examples
    --------
    >>> try:
    ...     load_scenario("hills", {"radar.snr_db": -1000})
    ... except ScenarioError as error:
    ...     print(error.problems[0])
    radar.snr_db: must be at least -100, not -1000
    """

    def __init__(self, problems: Iterable[Problem], source: str = UNNAMED) -> None:
        self.problems = tuple(problems)
        self.source = source
        super().__init__(str(self))

    @classmethod
    def of(cls, field: str, message: str, source: str = UNNAMED) -> "ScenarioError":
        """Return the error of a single problem."""
        return cls([Problem(field, message)], source)

    @classmethod
    def of_option(cls, option: str, message: str) -> "ScenarioError":
        """Return the error of an option of a command."""
        return cls.of(option, message, "command line")

    def __str__(self) -> str:
        lines = [f"{self.source}: {len(self.problems)} problem{'s' * (len(self.problems) != 1)}"]
        return "\n".join(lines + [f"  {problem}" for problem in self.problems])


@contextmanager
def named_after(source: str) -> Iterator[None]:
    """Add the name of a scenario's file to errors that name none."""
    try:
        yield
    except ScenarioError as error:
        if error.source == UNNAMED:
            error.source = source
        raise


class InputFileError(RadarError, ValueError):
    """A file that cannot be read or has the wrong content."""


class OutputError(RadarError, OSError):
    """A location that results cannot be written to."""


class KeptElsewhereError(OutputError):
    """Results that could not be written to the requested folder, and were saved under another name."""


class BackendError(RadarError, RuntimeError):
    """Mitsuba and Dr.Jit cannot run here; the message names the remedy for this platform."""


class PoseError(RadarError, ValueError):
    """A pose that a stepped radar cannot be at: not finite, of another shape, or not after the one before."""


class PluginError(RadarError, TypeError):
    """A plug-in that cannot be registered: its name is taken, or its parameter table is invalid."""


class WorkerError(RadarError, RuntimeError):
    """Workers that cannot be started, reached or used, or a task that failed on them."""


class WorkersLostError(WorkerError):
    """Workers or a scheduler that ended while tasks were running."""


# Name of an exception before its message, as other languages' errors carry it: "IoError: ...".
EXCEPTION_NAME = re.compile(r"\A(?:\w+(?:\.|::))*\w*(?:Error|Exception): ")
# Characters of another library's message that are repeated.
MAX_REASON = 200


def reason_of(error: BaseException) -> str:
    """Return the first line of another library's message, without the name of the exception; that alone for none."""
    lines = EXCEPTION_NAME.sub("", str(error).strip()).splitlines()
    return (lines or [type(error).__name__])[0][:MAX_REASON]


def one_line(error: Exception) -> str:
    """Return the message of an error on one line, its problems separated by semicolons."""
    problems = getattr(error, "problems", ())
    return "; ".join(map(str, problems)) or str(error)
