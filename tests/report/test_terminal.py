"""Tables print what they are given, on any encoding; progress is told off a terminal too."""

import io
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from sionna_radar.report.drawing import readable
from sionna_radar.report.survey.products import DOCUMENT
from sionna_radar.report.terminal import console, lines, number
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.result import Survey

MARKUP = "Trial [/x] [bold]b[/bold] :smile: ± µ"


def test_markup_is_printed_literally(survey: Survey, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = survey.scenario.model_copy(update={"description": MARKUP})

    def mine() -> None: ...

    mine.__qualname__ = "mine.[/x]"
    DOCUMENT.show(
        replace(survey, prepared=replace(survey.prepared, scenario=scenario, custom=CustomParts(sensor=mine)))
    )
    printed = capsys.readouterr().out
    assert MARKUP in printed
    assert "mine.[/x]" in printed


def test_the_survey_s_table_leads_with_lit_cells(survey: Survey, capsys: pytest.CaptureFixture[str]) -> None:
    other = replace(survey.lit_error, rms_m=0.125, count=survey.lit_error.count - 7)
    lit_cells = survey.lit.copy()
    lit_cells[:10] = False
    DOCUMENT.show(replace(survey, lit=lit_cells, lit_error=other, off_wall_error=replace(other, rms_m=0.0625)))
    printed = capsys.readouterr().out
    covered, lit, off_wall = (printed.index(text) for text in ("coverage", "0.125 m", "0.062 m"))
    assert covered < lit < off_wall
    assert f"{survey.dem_error.count:,}" not in printed  # the cells that no beam reached are not spoken of
    assert "LE68, 90, 95: percentiles of |error|" in printed


# The command line once for each line of arguments, in one interpreter: the heavy libraries load once.
COMMANDS = """
import json, sys
from sionna_radar.cli.app import main
for arguments in json.loads(sys.argv[1]):
    sys.argv = ["sionna-radar", *arguments]
    try:
        main()
    except SystemExit as stop:
        if stop.code:
            raise
    print("END OF COMMAND", flush=True)
"""


def test_an_ascii_terminal_takes_all_that_is_printed(small: Path, tmp_path: Path) -> None:
    scenario = tmp_path / "marked.toml"
    scenario.write_text(f'description = "{MARKUP} 山"\n{small.read_text()}', encoding="utf-8")
    ascii_only = os.environ | {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    vary = ["--vary", "processing.ranging=peak", "--repeat", "2", "-o", str(tmp_path / "out")]
    commands = [
        ["sweep", str(scenario), *vary],
        ["run", str(scenario), "-o", str(tmp_path / "run"), "--no-report"],
        ["scenes"],
    ]
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS, json.dumps(commands)], capture_output=True, check=False, env=ascii_only
    )
    assert done.returncode == 0, done.stderr
    swept, flown, listed, _ = done.stdout.decode("ascii").split("END OF COMMAND")
    assert "+- 0." in swept
    widths = {len(line) for line in swept.splitlines() if line.startswith("|")}
    assert len(widths) == 1, swept
    assert "[bold]b[/bold] :smile: +- u \\u5c71" in flown
    assert "hills" in listed


def test_a_number_that_does_not_exist_is_a_dash() -> None:
    assert number(float("nan"), ".3f", " m") == "-"
    assert number(-0.0314, "+.3f", " m") == "-0.031 m"


def test_a_console_neither_marks_nor_wraps_away() -> None:
    out = console()
    out.file = io.StringIO()
    out.print("[red]x[/red]")
    assert out.file.getvalue() == "[red]x[/red]\n"


def test_off_a_terminal_a_line_comes_now_and_then() -> None:
    written: list[str] = []
    times = iter([0.0, 1.0, 9.9, 10.0, *(15.0 + 0.5 * k for k in range(12)), 31.0])
    report = lines(written.append, lambda: next(times))
    tracing = [("tracing", done, 9000) for done in (100, *range(200, 4601, 400))]
    for step in (("preparing", 0, 0), ("preparing", 1, 1), *tracing, ("mapping", 0, 0)):
        report(*step)
    # 400 steps take half a second; the first hundred took five.
    assert written == ["tracing: 100 of 9,000", "tracing: 4,200 of 9,000, about 6 s left", "mapping"]


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("radar.antenna.beamwidth_deg", "Beamwidth (deg)"),
        ("platform.speed_mps", "Speed (m/s)"),
        ("weather.rain_rate_mm_per_h", "Rain rate (mm/h)"),
        ("radar.snr_db", "SNR (dB)"),
        ("dem.method", "DEM method"),
        ("processing.ranging", "Ranging"),
        ("seed", "Seed"),
    ],
)
def test_keys_are_told_in_words_with_units(key: str, words: str) -> None:
    assert readable(key) == words
