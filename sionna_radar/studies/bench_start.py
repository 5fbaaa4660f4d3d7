"""How long a new process takes until it works."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter

from sionna_radar.studies.ratio import Ratio

START_RATIOS = 3
REPEATS = 3


def measure_start() -> Iterator[Ratio]:
    """Yield the seconds of an import, of `--help` and of a first survey from the shell."""
    yield _new_process("`import sionna_radar`, beside Python's own start", [["-c", "import sionna_radar"]], 0.15)
    yield _new_process("`--help`, beside Python's own start", [["-m", "sionna_radar", "--help"]], 0.15)
    with tempfile.TemporaryDirectory() as folder:
        flights = [
            ["-m", "sionna_radar", "run", "hills", "-q", "-o", str(Path(folder, str(k)))] for k in range(REPEATS)
        ]
        yield _new_process("`run hills`, beside Python's own start", flights, 3.0)


def _new_process(name: str, commands: list[list[str]], bound_s: float) -> Ratio:
    """Return the least time of some processes, less that of one that does nothing; the first fills caches."""
    python_s = min(_seconds(["-c", "pass"]) for _ in range(REPEATS))
    repeated = commands if len(commands) > 1 else commands * REPEATS
    own_s = min([_seconds(command) for command in repeated][1:]) - python_s
    return Ratio(name=f"seconds of {name}", value=own_s, bound=bound_s, at_most=True)


def _seconds(arguments: list[str]) -> float:
    # Users' byte code is kept: without it half of the time goes into compiling modules.
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    start = perf_counter()
    subprocess.run([sys.executable, *arguments], capture_output=True, check=True, env=kept)
    return perf_counter() - start
