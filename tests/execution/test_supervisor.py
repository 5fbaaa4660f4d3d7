"""A program that something kills ends with one clear line; signals, exit codes and its own death are passed on."""

import os
import signal
import subprocess
import sys

import pytest

from processes import all_ended

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are watched on Linux alone")
CODE = """
import os, signal, sys, time
from sionna_radar.foundation.interrupts import interrupts_reported
from sionna_radar.execution.supervisor import supervised
# Ignored in what a shell starts in the background.
signal.signal(signal.SIGINT, signal.default_int_handler)
def program():
    with interrupts_reported():
        print(os.getpid(), flush=True)
        {does}
supervised(program)
"""


def begin(does: str) -> subprocess.Popen:
    command = [sys.executable, "-c", CODE.format(does=does)]
    buffered = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env=buffered, start_new_session=True, **piped)


@pytest.mark.parametrize(
    ("does", "says"),
    [
        ("os.abort()", "a library that aborted (SIGABRT)"),
        ("os.kill(os.getpid(), signal.SIGSEGV)", "(SIGSEGV)"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "out of memory (SIGKILL)"),
    ],
)
def test_what_is_killed_leaves_one_clear_line(does, says):
    _, said = (process := begin(does)).communicate(timeout=30)
    assert process.returncode == 1
    assert said.startswith("error: ")
    assert said.count("\n") == 1
    assert says in said
    assert "--resume" in said


@pytest.mark.parametrize("code", [0, 1, 2, 130])
def test_exit_codes_are_those_of_the_program(code):
    _, said = (process := begin(f"sys.exit({code})")).communicate(timeout=30)
    assert (process.returncode, said) == (code, "")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("to_all", [False, True])
def test_signals_are_passed_on(number, code, to_all):
    """To the one that waits alone, and to both, as batch systems do."""
    process = begin("time.sleep(60)")
    child = int(process.stdout.readline())
    assert child != process.pid
    if to_all:
        os.kill(child, number)
    process.send_signal(number)
    _, said = process.communicate(timeout=50)
    assert process.returncode == code
    assert said.startswith("interrupted")
    assert said.count("\n") == 1


def test_a_signal_after_the_end_of_the_program_leaves_its_exit_code():
    late = "import atexit; parent = os.getpid(); atexit.register(lambda: os.getpid() == parent and os.kill(parent, 15))"
    code = CODE.replace("supervised(program)", f"{late}; supervised(program)").format(does="sys.exit(3)")
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL, timeout=30).returncode == 3


def test_the_death_of_the_one_that_waits_ends_the_program():
    process = begin("time.sleep(60)")
    process.stdout.readline()
    process.kill()
    process.communicate()
    assert all_ended(process.pid)
