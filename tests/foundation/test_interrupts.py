"""An interrupt ends the program with one line and 130 or 143, even if something swallows it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from sionna_radar.execution.checkpoints import FOLDER

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX systems")

# What a program may be doing when the signal comes: `strike` sends it to the process itself.
PROGRAMS = {
    "plain work": "strike()",
    "a destructor, which swallows": """
class Swallows:
    def __del__(self):
        strike()

thing = Swallows()
del thing
raise_received()
""",
    "a destructor at the very end": """
class Swallows:
    def __del__(self):
        strike()

thing = Swallows()
del thing
""",
    "a destructor that raises an error of its own": """
class Swallows:
    def __del__(self):
        try:
            strike()
        except BaseException:
            raise AttributeError("closed already")

thing = Swallows()
del thing
""",
    "a callback of a weak reference": """
import weakref

class Thing:
    pass

thing = Thing()
seen = weakref.ref(thing, lambda _: strike())
del thing
""",
    "a binding that makes it a TypeError": """
try:
    strike()
except BaseException:
    raise TypeError("incompatible function arguments")
""",
    "a bare except, then progress": """
from sionna_radar.foundation.progress import advance

try:
    strike()
except:
    pass
advance()
print("went on")
""",
    "a command that then ends well": """
try:
    strike()
except BaseException:
    sys.exit(0)
""",
}
HEAD = """
import os, signal, sys
from sionna_radar.foundation.interrupts import interrupts_reported, raise_received

signal.signal(signal.SIGINT, signal.default_int_handler)

def strike():
    os.kill(os.getpid(), {number})

with interrupts_reported():
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("kind", PROGRAMS)
def test_an_interrupt_is_told_in_one_line(kind: str, number: signal.Signals) -> None:
    body = "".join(f"    {line}\n" for line in PROGRAMS[kind].strip().splitlines())
    code = HEAD.format(number=int(number)) + body
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 128 + number
    assert done.stdout == ""
    assert done.stderr == "interrupted\n"


def test_what_else_a_destructor_raises_is_reported() -> None:
    code = """
class Breaks:
    def __del__(self):
        raise ValueError("of its own")

thing = Breaks()
del thing
"""
    body = "".join(f"    {line}\n" for line in code.strip().splitlines())
    program = [sys.executable, "-c", HEAD.format(number=int(signal.SIGINT)) + body]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "Exception ignored in" in done.stderr
    assert "ValueError: of its own" in done.stderr


@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.study), signal.SIGTERM])
def test_an_interrupted_flight_leaves_nothing_but_its_finished_parts(
    small: Path, tmp_path: Path, number: signal.Signals
) -> None:
    code = f"""
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.argv = ["sionna-radar", "run", {str(small)!r}, "-q", "-o", {str(tmp_path / "out")!r}]
from sionna_radar.report.survey import products
products._write_trajectory = lambda survey, directory: os.kill(os.getpid(), {int(number)})
from sionna_radar.__main__ import main
main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    said = "interrupted; finished tasks are saved; continue with the same command and --resume\n"
    assert (done.returncode, done.stderr) == (128 + number, said)
    assert [path.name for path in (tmp_path / "out").iterdir()] == [FOLDER]


def test_an_ignored_interrupt_stays_ignored() -> None:
    code = HEAD.format(number=int(signal.SIGINT)).replace("signal.default_int_handler", "signal.SIG_IGN")
    done = subprocess.run([sys.executable, "-c", f"{code}    strike()\n"], capture_output=True, check=False)
    assert done.returncode == 0
