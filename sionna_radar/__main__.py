"""`python -m sionna_radar` is `sionna-radar`; interrupts are handled from before the first heavy import."""

import gc
import os
import sys
from importlib.util import cache_from_source
from pathlib import Path

from sionna_radar.execution.supervisor import supervised
from sionna_radar.foundation.interrupts import interrupts_reported

# New objects after which unused cycles of them are looked for; those before the first look are left alone for good.
OBJECTS_AT_FIRST, OBJECTS_AT_ONCE = 500_000, 10_000
# OpenBLAS: threads without work spin for two to this power of clock cycles, 16, and then sleep. By default they spin
# for 25 ms, at their start and after each product, though a survey uses one thread alone.
SPIN_VARIABLE, SPIN_EXPONENT = "OPENBLAS_THREAD_TIMEOUT", "4"


def main() -> None:
    """Run the command line."""
    supervised(_command_line)


def _command_line() -> None:
    _tell_of_first_start()
    # Imports make hundreds of thousands of objects that stay; looking through them again and again takes a sixth of the
    # time until the first result.
    gc.set_threshold(OBJECTS_AT_FIRST)
    gc.callbacks.append(_look_more_often)
    os.environ.setdefault(SPIN_VARIABLE, SPIN_EXPONENT)
    with interrupts_reported():
        from sionna_radar.cli.app import main as command_line

        command_line()


def _tell_of_first_start() -> None:
    """Say on a terminal that this start takes seconds, if Python has no byte code of the modules yet."""
    kept = Path(cache_from_source(str(Path(__file__).with_name("cli") / "app.py")))
    if sys.stderr.isatty() and not {"-q", "--quiet"} & set(sys.argv) and not kept.exists():
        sys.stderr.write("starting, Python compiles the modules first\n")


def _look_more_often(phase: str, _: object) -> None:
    """Leave the objects of imports, nearly all of which stay, out of all looks, which come sooner from now on."""
    if phase == "start":
        gc.callbacks.remove(_look_more_often)
        gc.freeze()
        gc.set_threshold(OBJECTS_AT_ONCE)


if __name__ == "__main__":
    main()
