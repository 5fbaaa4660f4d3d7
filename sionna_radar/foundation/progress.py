"""Progress of long computations, reported like log messages: from anywhere, to the listener of the context."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from sionna_radar.foundation.interrupts import raise_received

# Called at the start of a stage and after each of its steps with the stage's name, the steps done, and the total number
# of steps, 0 if unknown.
Progress = Callable[[str, int, int], None]


def silent(stage: str, done: int, total: int) -> None:
    """Report nothing."""


class _Stage:
    """A stage of a computation, and how many of its steps are done; a total of 0 is unknown."""

    def __init__(self, name: str, total: int) -> None:
        self.name, self.total, self.done = name, total, 0

    def report(self) -> None:
        report(self.name, self.done, self.total)


_listener: ContextVar[Progress] = ContextVar("listener", default=silent)
_current: ContextVar[_Stage | None] = ContextVar("current stage", default=None)


@contextmanager
def progress_to(listener: Progress) -> Iterator[None]:
    """Report the progress of this context to a listener; steps do not count for stages outside of it."""
    listening, stage_before = _listener.set(listener), _current.set(None)
    try:
        yield
    finally:
        _listener.reset(listening)
        _current.reset(stage_before)


def report(stage: str, done: int, total: int) -> None:
    """Report the steps of a stage that are done to the listener; total 0 if unknown."""
    raise_received()
    _listener.get()(stage, done, total)


@contextmanager
def stage(name: str, total: int = 0) -> Iterator[None]:
    """Compute a stage, whose steps are counted by `advance`; without an exception it ends with all of them done.

    total: number of steps; 0 if unknown, or until `expect_steps` gives it.
    """
    current = _Stage(name, total)
    current.report()
    before = _current.set(current)
    try:
        yield
    finally:
        _current.reset(before)
    if current.done != current.total or current.done == 0:
        current.done = current.total = max(current.done, current.total, 1)
        current.report()


def expect_steps(total: int) -> None:
    """Set the number of steps of the current stage, none of which is done."""
    current = _current.get()
    if current is not None:
        current.done, current.total = 0, total
        current.report()


def advance(count: int = 1) -> None:
    """Count steps of the stage, and raise an interrupt that has come; pools have none, see `several_at_once`."""
    raise_received()
    current = _current.get()
    if current is not None and count > 0:
        current.done += count
        current.report()


def steps_done() -> int:
    """Return the number of steps of the current stage that are done."""
    current = _current.get()
    return 0 if current is None else current.done
