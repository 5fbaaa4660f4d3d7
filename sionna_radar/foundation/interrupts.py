"""Ctrl-C and SIGTERM end the program with one line and exit code 130 or 143, whatever it is doing.

An exception that a signal raises can be lost: destructors and callbacks from C code swallow it, and a binding to C++
may turn it into a TypeError. So the signal is also remembered: `raise_received`, called at every step of progress,
raises it again, and whatever ends the program after a signal is taken for its interrupt.

Nothing but the standard library's lightest modules is imported here: this stands before all other imports.
"""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)

_received: list[int] = []
# How many signals came in each block that holds the first of them back.
_held_back: list[int] = []


class Interrupted(BaseException):
    """A signal asked the program to end."""


def raise_received() -> None:
    """Raise Interrupted if a signal has come, even if its own exception was swallowed."""
    if _received:
        raise Interrupted


@contextmanager
def held_back() -> Iterator[None]:
    """Let the first signal wait for the end of a block, such as the writing of what hours have made."""
    _held_back.append(0)
    try:
        yield
    finally:
        came = _held_back.pop()
    if came:
        raise Interrupted


@contextmanager
def interrupts_reported() -> Iterator[None]:
    """Run the whole program: an interrupt ends it with one line on standard error and exit code 128 + signal."""
    _received.clear()
    for number in SIGNALS:
        # A shell that starts a program in the background has it ignore Ctrl-C; that is to stay so.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)
    try:
        yield
    except BaseException:
        if not _received:
            raise
    finally:
        # All is written by now; a traceback from the interpreter's own end would say nothing.
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
    if _received:
        sys.stderr.write("interrupted\n")
        sys.exit(128 + _received[0])


def _interrupt(number: int, _: FrameType | None) -> None:
    _received.append(number)
    if _held_back:
        _held_back[-1] += 1
        if _held_back[-1] == 1:
            return
    raise Interrupted
