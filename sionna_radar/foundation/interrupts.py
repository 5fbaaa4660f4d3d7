"""Handling of Ctrl-C and SIGTERM: the program ends with one line and exit code 130 or 143 at any time.

An exception that a signal raises can be lost: destructors and callbacks from C code swallow it, and a binding to C++
may turn it into a TypeError. So the signal is also remembered: `raise_received`, called at every step of progress,
raises it again, and any end of the program after a signal counts as an interrupt. Python's report of the exception that
a destructor swallowed ("Exception ignored in ...") is left out, since the signal is not ignored.

Only the lightest modules of the standard library are imported here, as this comes before all other imports.
"""

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

SIGNALS = (signal.SIGINT, signal.SIGTERM)

# A second signal this soon is the first one, come by another way.
SAME_WITHIN_S = 0.5

_received: list[int] = []
_last_at: list[float] = [0.0]


class Interrupted(BaseException):
    """A signal asked the program to end."""


def raise_received() -> None:
    """Raise Interrupted if a signal has come, even if its own exception was swallowed."""
    if _received:
        raise Interrupted


@contextmanager
def until_interrupted() -> Iterator[None]:
    """Run a block without an end of its own: an interrupt ends it, and the program goes on after it."""
    try:
        yield
        raise_received()
    except (Interrupted, KeyboardInterrupt):
        _received.clear()


@contextmanager
def interrupts_reported() -> Iterator[None]:
    """Run the whole program: an interrupt ends it with one line on standard error and exit code 128 + signal."""
    _received.clear()
    for number in SIGNALS:
        # A shell that starts a program in the background makes it ignore Ctrl-C; this is kept.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)
    notes: list[str] = []
    report_ignored = sys.unraisablehook

    def report_unless_interrupted(ignored: "UnraisableHookArgs") -> None:
        if not _caused_by_signal(ignored.exc_value):
            report_ignored(ignored)

    sys.unraisablehook = report_unless_interrupted
    try:
        yield
    except BaseException as error:
        if not _received:
            raise
        notes = getattr(error, "__notes__", notes)
    finally:
        # Everything is written by now; a traceback from the interpreter's shutdown would be meaningless.
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        sys.unraisablehook = report_ignored
    if _received:
        sys.stderr.write("; ".join(["interrupted", *notes]) + "\n")
        sys.exit(128 + _received[0])


def _caused_by_signal(error: BaseException | None) -> bool:
    """Whether an exception is `Interrupted`, or was raised while that was handled."""
    while error is not None and not isinstance(error, Interrupted):
        error = error.__cause__ or error.__context__
    return error is not None


def _interrupt(number: int, _: FrameType | None) -> None:
    now = time.monotonic()
    if _received and now - _last_at[0] < SAME_WITHIN_S:
        # Batch systems send a signal to all processes, and the one that watches this one passes it on.
        return
    _last_at[:] = [now]
    _received.append(number)
    raise Interrupted
