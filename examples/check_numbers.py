"""Make the numbers of the checks pages again, and say which moved.

    uv run python examples/check_numbers.py             # all of them: some twenty minutes on two cores
    uv run python examples/check_numbers.py plot_rain   # those of one example
    uv run python examples/check_numbers.py --record    # what is printed now becomes the record

Each example runs as its page says, in a folder of its own. What it prints stands beside what it printed when the page
was written (`numbers.txt`). The exit code is 1 if a line differs: look for the reason before the page is changed. Last
digits may differ from one kind of processor to another.
"""

import argparse
import difflib
import re
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
RECORD = HERE / "numbers.txt"
EXAMPLES = (
    "plot_fig05_antenna",
    "plot_fig08_roof_edge",
    "plot_fig10_two_fields",
    "plot_fig11_doppler",
    "plot_fig12_hills",
    "plot_fig13_edge_error",
    "plot_fig14_buildings",
    "plot_table3_beamwidth",
    "plot_maps",
    "plot_rain",
    "weather_tables",
    "plot_radar_and_lidar",
    "lidar_as_built",
    "plot_why_radar",
    "plot_circular",
    "plot_altimeter",
    "published_mapper",
    "altimeters",
    "plot_altimeter_crop",
)


def recorded() -> dict[str, str]:
    """Return what each example printed when its numbers were recorded."""
    parts = re.split(r"^== (\w+)\n", RECORD.read_text(encoding="utf-8") if RECORD.exists() else "", flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def printed(name: str) -> str:
    """Return what an example prints at full size."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(HERE / f"{name}.py")]
        return subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, text=True, check=True).stdout


def main() -> int:
    """Run examples and print the lines that moved; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[*EXAMPLES, []], metavar="NAME", help=", ".join(EXAMPLES))
    parser.add_argument("--record", action="store_true", help="write what is printed into numbers.txt")
    arguments = parser.parse_args()
    record, moved = recorded(), False
    for name in arguments.names or EXAMPLES:
        now = printed(name)
        changes = list(difflib.ndiff(record.get(name, "").splitlines(), now.splitlines()))
        lines = [line for line in changes if line[0] in "-+"]
        moved = moved or bool(lines)
        print(f"{name}: {'moved' if lines else 'as recorded'}", *lines, sep="\n", flush=True)
        record[name] = now
        if arguments.record:
            RECORD.write_text("".join(f"== {each}\n{record[each]}" for each in EXAMPLES if each in record), "utf-8")
    return int(moved and not arguments.record)


if __name__ == "__main__":
    sys.exit(main())
