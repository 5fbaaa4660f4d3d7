"""How long a new process takes until it works."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import perf_counter

from sionna_radar.studies.ratio import Ratio

START_RATIOS = 4
REPEATS = 3


def measure_start() -> Iterator[Ratio]:
    """Yield the seconds of an import, of `--help` and of a first survey from the shell, all beside Python's own."""
    python_s = min(_seconds(["-c", "pass"])[1] for _ in range(REPEATS))
    for name, arguments in (
        ("`import sionna_radar`", ["-c", "import sionna_radar"]),
        ("`--help`", ["-m", "sionna_radar", "--help"]),
    ):
        yield _ratio(name, [_seconds(arguments)[1] for _ in range(REPEATS)], python_s, 0.15)
    with tempfile.TemporaryDirectory() as folder:
        flights = [
            _seconds(["-m", "sionna_radar", "run", "hills", "-o", str(Path(folder, str(k)))]) for k in range(REPEATS)
        ]
    first, last = zip(*flights, strict=True)
    yield _ratio("`run hills` until the result is printed", first, python_s, 3.0)
    yield _ratio("`run hills` until all is written and drawn", last, python_s, None)


def _ratio(name: str, seconds: Sequence[float], python_s: float, bound_s: float | None) -> Ratio:
    """Return the least time of some processes but the first, which fills caches, less that of one that does nothing."""
    return Ratio(name=f"seconds of {name}", value=min(seconds[1:]) - python_s, bound=bound_s, at_most=True)


def _seconds(arguments: list[str]) -> tuple[float, float]:
    """Return the seconds until a process has said something, or has ended without, and until it has ended."""
    # Users' byte code is kept: without it half of the time goes into compiling modules.
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    command, start = [sys.executable, *arguments], perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=kept) as process:
        assert process.stdout is not None
        process.stdout.readline()
        said_s = perf_counter() - start
        process.stdout.read()
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return said_s, perf_counter() - start
