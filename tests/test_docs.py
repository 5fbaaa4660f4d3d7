"""The pages: their Python runs, their commands exist, their links lead to files, and nothing is left out of them."""

import re
import shlex
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import typer.main

from sionna_radar import parse_scenario
from sionna_radar.cli.app import app
from sionna_radar.scenario import WeatherTable
from sionna_radar.scenario.platform import LOG_KEYS
from sionna_radar.scenario.recorded import DescribedRecording
from sionna_radar.scenario.terrain import MeshFile
from sionna_radar.tracing import build_weather
from sionna_radar.weather import volume_of

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "examples").rglob("*.md")),
    *(page for page in sorted(DOCS.rglob("*.md")) if not {"generated", "gallery", "_build"} & set(page.parts)),
]
# Flown in this process; PRODUCTS.md has a test of its own, which needs the files of a survey.
RUN = ["parts.md", "recordings.md", "first_survey.md"]


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


# Characters of a line of code that a page shows without scrolling.
COLUMN = 100


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def command_lines(page: Path) -> list[str]:
    """Return the command lines of a page: those of its shell blocks, and those in code within the text."""
    text = page.read_text(encoding="utf-8")
    shell = "\n".join(re.findall(r"```(?:sh|console)?\n(.*?)```", text, re.DOTALL)).replace("\\\n", " ")
    lines = [line.removeprefix("$ ").removeprefix("uv run ") for line in shell.splitlines()]
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    code = [" ".join(part.split()).removeprefix("uv run ") for part in re.findall(r"`([^`]+)`", prose)]
    return [line for line in [*lines, *code] if line.startswith("sionna-radar ")]


def parse(line: str) -> None:
    """Parse a command line as the program does, without running it."""
    words = shlex.split(line, comments=True)[1:]
    if ">" in words:
        words = words[: words.index(">")]
    group = typer.main.get_command(app)
    if words[0].startswith("-"):  # of the program itself: --version, --install-completion
        options = {option for parameter in group.params for option in parameter.opts}
        assert words[0] in options, words
        return
    with typer.Context(group, info_name="sionna-radar") as context:
        command = group.get_command(context, words[0])
        assert command is not None, f"{line}: no such command"
        # A command alone is named, not called.
        if len(words) > 1:
            command.make_context(words[0], words[1:], parent=context, resilient_parsing=False)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_command_lines_parse(page):
    wrong = {}
    for line in command_lines(page):
        try:
            parse(line)
        except Exception as error:
            wrong[line] = str(error)
    assert wrong == {}


def test_a_wrong_command_line_is_noticed():
    with pytest.raises(AssertionError, match="no such command"):
        parse("sionna-radar fly hills")
    with pytest.raises(Exception, match="--sett"):
        parse("sionna-radar run hills --sett seed=1")


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_to_files(page):
    text = re.sub(r"```(?!\{).*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    links = re.findall(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)", text)
    links += re.findall(r"^```\{(?:include|literalinclude)\} (\S+)", page.read_text(encoding="utf-8"), re.MULTILINE)
    for link in links:
        # Pages made when the documentation is built; the build itself, where warnings are errors, checks these.
        if "://" not in link and not {"generated", "gallery"} & set(Path(link).parts):
            assert (page.parent / link).exists(), f"{name(page)} links to {link}"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_rows_of_a_table_have_as_many_cells_as_its_head(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    # A bar within code, or after a backslash, parts no cells.
    text = re.sub(r"`[^`\n]*`|\\\|", "code", text)
    tables = re.findall(r"^\|.*\|[ ]*\n\|[ :|-]+\|[ ]*\n(?:\|.*\n?)*", text, re.MULTILINE)
    for table in tables:
        rows = table.splitlines()
        assert {row.rstrip().count("|") for row in rows} == {rows[0].rstrip().count("|")}, rows[0]


def merged(block: str) -> dict:
    """Return the scenario of a block: `hills`, with the tables of the block in place of or within its own."""
    tables = tomllib.loads((ROOT / "scenes" / "hills.toml").read_text(encoding="utf-8"))
    tables["materials"] |= dict.fromkeys(("metal", "forest"), tables["materials"]["ground"])  # of the reader's own
    for key, value in tomllib.loads(block).items():
        mine = tables.get(key)
        tables[key] = mine | value if isinstance(mine, dict) and "kind" not in value else value
    if "log" in tables["platform"]:  # a log takes the place of the plan
        tables["platform"] = tomllib.loads(block)["platform"]
    return tables


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "toml")], ids=name)
def test_scenarios_on_a_page_are_valid(page):
    for block in blocks(page, "toml"):
        if {"recording", "readings"} & tomllib.loads(block).keys():
            assert DescribedRecording.model_validate(tomllib.loads(block)).poses
            continue
        tables = merged(block)
        assert parse_scenario(tables).terrain.kind == tables["terrain"]["kind"]


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_code_fits_into_the_column(page):
    for language, block in re.findall(r"```(\w*)\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
        wide = [line for line in block.splitlines() if len(line) > COLUMN and language != "text"]
        assert not wide, "what a program prints may be wider, and is scrolled"


@pytest.mark.usefixtures("forgotten")
@pytest.mark.parametrize("page", RUN)
def test_python_on_a_page_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = blocks(DOCS / page, "python")
    assert code
    for number, block in enumerate(code, 1):
        exec(compile(block, f"{page}, block {number}", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out


def shown_by_commands(page: Path) -> list[tuple[list[str], str]]:
    """Return the commands up to each block of console output, and that output."""
    parts = re.findall(r"```(sh|text)\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    shown, since = [], []
    for language, block in parts:
        if language == "sh":
            since += block.splitlines()
        else:
            shown.append((since, block))
            since = []
    return shown


def numbers_apart(text: str, folder: Path) -> tuple[list[str], list[float]]:
    """Return the words of an output and its numbers, without the place of the folder and the seconds that it took."""
    text = re.sub(r"[\d.]+ s for", "s for", re.sub(r"\s+", " ", text.replace(f"{folder}/", "")))
    return re.sub(r"[-+]?[\d,]*\.?\d+", "#", text).split(), [
        float(number.replace(",", "")) for number in re.findall(r"[-+]?[\d,]*\.?\d+", text)
    ]


def test_console_output_on_a_page_is_that_of_its_commands(cli, tmp_path, monkeypatch):
    """The last digits are another processor's."""
    monkeypatch.chdir(tmp_path)
    shown = shown_by_commands(DOCS / "first_survey.md")
    assert len(shown) == 2
    for lines, expected in shown:
        for line in lines:
            name, *rest = shlex.split(line)[1:]
            if name in ("init", "validate", "run"):
                done = cli(name, *rest, code=None)
        # A slow machine tells its progress, and one without a cache that it compiles.
        said = re.sub(r"^(\w+: [\d,]+ of [\d,]+|compiling).*\n?", "", done.stderr, flags=re.MULTILINE)
        words, numbers = numbers_apart(done.stdout + said, tmp_path)
        assert (words, numbers) == (
            numbers_apart(expected, tmp_path)[0],
            pytest.approx(numbers_apart(expected, tmp_path)[1], rel=0.02),
        )


def test_the_report_of_a_machine_on_a_page_has_the_lines_of_doctor(cli, monkeypatch):
    """What stands in them is another machine's."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    ((_, shown),) = shown_by_commands(DOCS / "install.md")
    lines = shown.splitlines()
    printed = [line for line in cli("doctor").stdout.splitlines() if not line.startswith("plug-in")]
    assert [line[:16] for line in lines[:-1]] == [line[:16] for line in printed[:-1]]
    assert lines[-1] == printed[-1]


def test_every_example_has_a_place_in_the_gallery_and_a_title():
    placed = (DOCS / "_ext" / "example_gallery.py").read_text(encoding="utf-8")
    for path in sorted((ROOT / "examples").glob("plot_*.py")):
        stem = path.stem.removeprefix("plot_")
        assert re.search(rf"\b{stem}\b", placed), f"{path.name} is in no section of the gallery"
        first, title, underline, *_ = path.read_text(encoding="utf-8").splitlines()
        assert first.startswith(('"""', 'r"""'))
        assert set(underline) == {"="}
        assert len(underline) >= len(title)


def test_every_page_and_example_page_is_in_the_contents():
    linked = "\n".join(page.read_text(encoding="utf-8") for page in DOCS.rglob("index.md"))
    for page in PAGES:
        if page.is_relative_to(DOCS) and page.stem != "index":
            assert re.search(rf"^{page.stem}$|/{page.stem}$", linked, re.MULTILINE), f"{name(page)} is in no contents"


def test_commands_stand_in_the_groups_of_the_help(cli):
    shown: dict[str, list[str]] = {}
    for line in cli("--help").stdout.splitlines():
        if group := re.fullmatch(r"([A-Z][a-z ]+):", line):
            commands = shown.setdefault(group[1], [])
        elif shown and (name := re.match(r"  ([a-z-]+)\b", line)):
            commands.append(name[1])
    shown.pop("Options", None)
    page = (DOCS / "commands.md").read_text(encoding="utf-8")
    groups = {
        title: re.findall(r"^\| `sionna-radar ([a-z-]+)", text, re.MULTILINE)
        for title, text in re.findall(r"^## (.*)\n\n((?:\|.*\n)+)", page, re.MULTILINE)
    }
    assert {title: sorted(names) for title, names in groups.items() if names} == {
        title: sorted(names) for title, names in shown.items()
    }


def test_package_citation_and_changelog_name_one_release():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    number, date = re.findall(
        r"^## \[([\d.]+)\] - (\S+)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE
    )[0]
    assert re.findall(r"^version: (.*)$", citation, re.MULTILINE) == [version]
    assert re.findall(r"^date-released: (.*)$", citation, re.MULTILINE) == [date]
    assert number == version


@pytest.mark.parametrize("key", [*LOG_KEYS, *MeshFile.model_fields])
def test_the_page_of_real_worlds_names_every_key_of_logs_and_meshes(key):
    assert re.search(rf"\b{key}\b", (ROOT / "examples" / "WORLDS.md").read_text(encoding="utf-8"))


@pytest.mark.parametrize("word", ["bit for bit", "without a password", "memory of one process grows"])
def test_the_limits_say_plainly(word):
    assert word in " ".join((DOCS / "limits.md").read_text(encoding="utf-8").lower().split())


def air_of(name: str) -> WeatherTable:
    """Return the air that a row of the page of weather names: "wet snow, 4 mm/h", "dust, 1 km"."""
    kind, amount = name.split(", ")
    number, unit = float(amount.split()[0]), amount.split()[1]
    if kind == "rain":
        return WeatherTable(rain_rate_mm_per_h=number, temperature_k=283.15)
    if unit == "mm/h":
        return WeatherTable(snowfall_mm_per_h=number, snow=kind.removesuffix(" snow"), temperature_k=273.15)
    seen_m = number * {"km": 1e3, "m": 1.0}[unit]
    return WeatherTable(**{f"{kind}_visibility_m": seen_m, "temperature_k": 283.15})


def test_attenuations_and_echoes_on_the_page_of_weather_are_those_of_the_models():
    page = (ROOT / "examples" / "WEATHER.md").read_text(encoding="utf-8")
    head, _, *rows = re.search(r"\| air \|.*?GHz \|\n.*?\n\n", page, re.DOTALL).group().strip().splitlines()
    carriers_hz = [1e9 * float(ghz) for ghz in re.findall(r"([\d.]+) GHz", head)]
    assert len(rows) == 15
    for row in rows:
        name, *cells = [cell.strip() for cell in row.strip("|").split("|")]
        for carrier_hz, cell in zip(carriers_hz, cells, strict=True):
            if name == "the air itself":
                gases = build_weather(WeatherTable(gases=True, temperature_k=283.15), carrier_hz)
                assert cell == f"{gases.gas_attenuation_db_per_km:.2g}", row
                continue
            weather = build_weather(air_of(name), carrier_hz)
            loss_db_per_km = float(weather.attenuation_db_per_km(np.zeros(1))[0])
            loss, echo_db = cell.split(" / ")
            assert float(loss) == float(f"{loss_db_per_km:.2g}"), (row, loss_db_per_km)
            assert float(echo_db) == round(10 * np.log10(volume_of(weather).reflectivity_per_m)), row
