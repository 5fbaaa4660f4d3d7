"""A child process for the program, so that its parent reports how it ended.

The ray tracer calls abort() on an internal error, and the kernel kills a process when memory runs out: neither leaves
Python time for a message. A fork taken before anything heavy is loaded costs a millisecond. The parent passes SIGTERM
and Ctrl-C on to the child, and the child ends when its parent does.
"""

import atexit
import os
import signal
import sys
from collections.abc import Callable

PASSED_ON = (signal.SIGINT, signal.SIGTERM)
# Code of a signal that a terminal has sent to all processes in the foreground, so that it needs no passing on (Linux).
SI_KERNEL = 0x80
PR_SET_PDEATHSIG = 1
ADVICE = (
    "the result of an earlier command stands as it was; a smaller survey, block size or number of workers takes less "
    "memory, and where the output folder holds finished parts the same command with --resume goes on from them"
)


def supervised(program: Callable[[], None]) -> None:
    """Run a program in a child process, and exit with its code; with 1 and a line of text if something killed it.

    Both processes leave it by their exit alone.

    Where processes cannot be watched like that, on anything but Linux, it runs in this one.
    """
    if not sys.platform.startswith("linux"):
        program()
        return
    watched = {*PASSED_ON, signal.SIGCHLD}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, watched)
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        _die_with(parent)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        _run_and_leave(program)
        return
    status = _watch(child, watched)
    signal.pthread_sigmask(signal.SIG_SETMASK, before)
    sys.exit(_code(status))


def _run_and_leave(program: Callable[[], None]) -> None:
    """Run a program and end this process as soon as all that was to be done at its exit is done."""
    try:
        program()
        code = 0
    except SystemExit as leaving:
        if isinstance(leaving.code, str):  # a message, which the interpreter prints
            raise
        code = leaving.code or 0
    # In the order of the interpreter: threads, what modules have registered, and what is yet to be printed.
    import threading

    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:  # nobody reads any more; the interpreter has a way to say so
        sys.exit(code)
    os._exit(code)


def _watch(child: int, watched: set[signal.Signals]) -> int:
    """Pass signals on until the child has ended, and return its status, as `os.waitpid` does."""
    while True:
        came = signal.sigwaitinfo(watched)
        if came.si_signo in PASSED_ON:
            if came.si_code != SI_KERNEL:
                os.kill(child, came.si_signo)
            continue
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return status


def _code(status: int) -> int:
    """Return the exit code for a status of a child, and tell of one that did not end by itself."""
    code = os.waitstatus_to_exitcode(status)
    if code >= 0:
        return code
    number = -code
    if number in PASSED_ON:
        return 128 + number
    name = signal.Signals(number).name
    cause = "most likely for want of memory" if number == signal.SIGKILL else "by a library that could not go on"
    sys.stderr.write(f"error: the program was ended {cause} ({name}); {ADVICE}\n")
    return 1


def _die_with(parent: int) -> None:
    """Have the system end this process when its parent ends, however that ends."""
    import ctypes

    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
