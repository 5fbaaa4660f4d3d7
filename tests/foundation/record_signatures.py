"""Print `sionna_radar/foundation/signatures.txt`: `uv run python tests/foundation/record_signatures.py > FILE`.

Each survey runs in a process of its own with an empty cache, and says what was compiled in which order.
"""

import os
import subprocess
import sys
import tempfile

SURVEYS = {
    "linear": ["hills"],
    "smooth": ["hills", "dem.method=smooth"],
    "refined": ["hills", "dem.method=refined"],
    "stepped": ["san_francisco"],
}


def compiled_by(survey: list[str]) -> list[str]:
    """Return the lines of what a survey compiles, in order."""
    with tempfile.TemporaryDirectory() as cache:
        done = subprocess.run(
            [sys.executable, __file__, *survey],
            env=os.environ | {"NUMBA_CACHE_DIR": cache},
            capture_output=True,
            text=True,
            check=True,
        )
    return done.stdout.splitlines()


def print_signatures() -> None:
    """Print the sections of the file."""
    lines = {method: compiled_by(survey) for method, survey in SURVEYS.items()}
    shared = [line for line in lines["linear"] if all(line in others for others in lines.values())]
    print("[all]", *shared, sep="\n")
    for method, own in lines.items():
        print("", f"[{method}]", *(line for line in own if line not in shared), sep="\n")


def print_compiled(name: str, *assignments: str) -> None:
    """Fly a survey, and print what it compiled."""
    from numba.core import event

    from sionna_radar import load_scenario, run
    from sionna_radar.foundation.precompile import PACKAGE, described
    from sionna_radar.scenario.overrides import parse_overrides

    lines = dict[str, None]()

    class Compilations(event.Listener):
        def on_start(self, event):
            pass

        def on_end(self, event):
            function = event.data["dispatcher"].py_func
            if function.__module__.startswith(PACKAGE):
                arguments = "".join(described(each) + ", " for each in event.data["args"])
                lines[f"{function.__module__.removeprefix(PACKAGE + '.')} {function.__name__} ({arguments})"] = None

    event.register("numba:compile", Compilations())
    run(load_scenario(name, parse_overrides(list(assignments))))
    print(*lines, sep="\n")


if __name__ == "__main__":
    if sys.argv[1:]:
        print_compiled(*sys.argv[1:])
    else:
        print_signatures()
