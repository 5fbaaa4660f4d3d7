"""Reading the tables of HDF5 files in another process, as a damaged file may crash the library or never end.

One process reads the files of this one in turn. It ends with this one, and is replaced after a file with an error,
which may have left the library in disorder.
"""

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
import time
from functools import cache
from pathlib import Path

# Answers each path with its error, or an empty text. Ctrl-C reaches the processes of a terminal all together: only the
# first one decides what ends.
PROGRAM = """
import json, signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
import h5py

def read(name, item):
    dict(item.attrs)
    getattr(item, "shape", None), getattr(item, "chunks", None), getattr(item, "external", None)

for line in sys.stdin:
    try:
        with h5py.File(json.loads(line), "r") as file:
            dict(file.attrs)
            file.visititems(read)
        error = ""
    except Exception as caught:
        error = str(caught) or type(caught).__name__
    print(json.dumps(error), flush=True)
"""
LONGEST_S = 60.0


class TableReader:
    """Another process that reads tables of files; it starts when it is first asked.

    owner: the process that uses it; one forked from it leaves it alone.
    """

    def __init__(self, owner: int) -> None:
        self._owner = owner
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        atexit.register(self._end)

    def error(self, path: Path) -> str:
        """Return why the tables of a file cannot be read; empty if they can."""
        with self._lock:
            # One that has ended in the meantime, for want of memory, says nothing of this file.
            if self._process is None or self._process.poll() is not None:
                self._end()
                command, pipe = [sys.executable, "-c", PROGRAM], subprocess.PIPE
                self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True)
            error = "not known"
            try:
                error = _answer(self._process, path)
            finally:
                if error:
                    self._end()
            return error

    def _end(self) -> None:
        if self._process is not None and self._owner == os.getpid():
            self._process.kill()
            self._process.communicate()  # closes the pipes, and waits
            self._process = None


def _answer(process: subprocess.Popen[str], path: Path) -> str:
    assert process.stdin is not None
    assert process.stdout is not None
    overdue, start_s = threading.Timer(LONGEST_S, process.kill), time.monotonic()
    overdue.start()
    try:
        process.stdin.write(json.dumps(str(path.resolve())) + "\n")
        process.stdin.flush()
        answer = process.stdout.readline()
    except BrokenPipeError:
        answer = ""
    finally:
        overdue.cancel()
    if answer:
        return str(json.loads(answer))
    if time.monotonic() - start_s >= LONGEST_S:
        return f"its tables could not be read in {LONGEST_S:g} s"
    code = process.wait()
    if code < 0:
        return f"its tables crash the HDF5 library: {signal.strsignal(-code)}"
    return f"the process that reads its tables ended with exit code {code}"


@cache
def _reader_of(process: int) -> TableReader:
    return TableReader(process)


def error_of_tables(path: Path) -> str:
    """Return why another process cannot read the tables of an HDF5 file; empty if it can."""
    return _reader_of(os.getpid()).error(path)
