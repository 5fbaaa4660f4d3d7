"""Run the program in a child process whose parent reports abnormal ends.

Dr.Jit may abort() and the kernel's out-of-memory killer may end the process; Python can report neither. Forking before
anything heavy is imported costs a millisecond. The parent forwards SIGTERM and Ctrl-C, and the child ends with its
parent.
"""

import os
import signal
import sys
from collections.abc import Callable

PASSED_ON = (signal.SIGINT, signal.SIGTERM)
# si_code of a signal that the terminal sent to the whole foreground group and needs no forwarding (Linux).
SI_KERNEL = 0x80
PR_SET_PDEATHSIG = 1
ADVICE = (
    "earlier results are unchanged; a smaller survey, block size or number of workers needs less memory, and if the "
    "output folder holds checkpoints the same command with --resume continues from them"
)


def supervised(program: Callable[[], None]) -> None:
    """Run a program in a child process and exit with its code; with 1 and a message if it was killed.

    Only the child returns from this function. On systems other than Linux the program runs in this process.
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
        program()
        return
    # Still blocked here, so that a signal that comes after the child's end leaves its exit code as it is.
    sys.exit(_code(_watch(child, watched)))


def _watch(child: int, watched: set[signal.Signals]) -> int:
    """Forward signals until the child ends, and return its `os.waitpid` status."""
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
    """Return the exit code for a wait status, and report a child killed by a signal."""
    code = os.waitstatus_to_exitcode(status)
    if code >= 0:
        return code
    number = -code
    if number in PASSED_ON:
        return 128 + number
    name = signal.Signals(number).name
    cause = "most likely out of memory" if number == signal.SIGKILL else "by a library that aborted"
    sys.stderr.write(f"error: the program was ended {cause} ({name}); {ADVICE}\n")
    return 1


def _die_with(parent: int) -> None:
    """Let the kernel kill this process when its parent ends."""
    import ctypes

    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
