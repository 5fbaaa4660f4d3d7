"""Whole commands with hard inputs, each in a process that may die alone: a correct result, or one clear error.

The suite runs a few of each kind; `pytest -m hostile -n 0 --hostile-inputs 10000 --hostile-seed 1` as many as are
wanted, of all kinds of files, values and options of all commands: 10,000 in a night.
"""

import csv
import json
import math
import shutil

import numpy as np
import pytest
import rasterio
from hypothesis import HealthCheck, given, seed, settings

from command_server import CommandServer, Ended
from hard_files import damaged_files, subjects
from hard_inputs import KINDS as QUICK_KINDS
from hard_inputs import OPTIONS, HardInput, command_lines
from sionna_radar.execution.checkpoints import FOLDER
from surveys import SMALL

KINDS = QUICK_KINDS | {"damaged files": damaged_files(), "all commands": command_lines(sorted(OPTIONS))}
WITHIN_S = 300.0
# Everything loaded, and a survey of the greatest size that is let through.
MAX_MB = 4000.0
# Commands that end with 1 where the result is bad news: settings that failed, engines that disagree.
WRITE_NOTHING = ("validate", "fit")
MAY_END_WITH_1 = ("sweep", "merge", "crosscheck", "calibrate")


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A process that runs commands in a folder with a small scenario."""
    folder = tmp_path_factory.mktemp("hard")
    (folder / "small.toml").write_text(SMALL.replace("length_m = 10.0", "length_m = 4.0"))
    server = CommandServer(folder)
    yield server
    server.stop()


def check(server: CommandServer, hard: HardInput) -> None:
    """Run a command, and see that it ended as it should."""
    for name, content in hard.files.items():
        (server.folder / name).write_bytes(content() if callable(content) else content)
    before = {path.name for path in server.folder.iterdir()} | {"stdout", "stderr"}
    output = ["-o", "out"] if hard.arguments[0] not in WRITE_NOTHING else []
    ended = server.run([*hard.arguments, *output], WITHIN_S)
    try:
        assert_ended_well(ended, hard)
        left = {path.name for path in server.folder.iterdir()} - before
        if ended.code == 2 and "mended, continue with the same command and --resume" in ended.stderr:
            # What was flown is kept, and nothing else: a file that is read at the end may be given again, whole.
            assert [path.name for path in (server.folder / "out").iterdir()] == [FOLDER]
            assert left == {"out"}, f"left behind: {left}"
        elif ended.code == 2:
            assert not left, f"left behind: {left}"
        elif (server.folder / "out").is_dir():
            for path in (server.folder / "out").rglob("*"):
                assert_without_nan(path)
    finally:
        for path in server.folder.iterdir():
            if path.name not in before:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        for name in hard.files:
            (server.folder / name).unlink()


def assert_ended_well(ended: Ended, hard: HardInput) -> None:
    assert ended.code in (0, 1, 2), ended
    assert "Traceback" not in ended.stderr
    assert ended.peak_mb < MAX_MB
    if ended.code == 1:
        assert hard.arguments[0] in MAY_END_WITH_1, ended
    if ended.code == 2:
        # Either ours, or that of the library that reads command lines.
        assert ended.stderr.count("error:") + ended.stderr.count("Error:") + ended.stderr.count("╭─ Error") == 1, ended
        assert len(ended.stderr) < 10_000


def assert_without_nan(path) -> None:
    """Numbers that are not there are null, empty or no data, never NaN."""

    def refuse(word: str) -> None:
        raise AssertionError(path, word)

    if path.suffix in (".json", ".geojson"):
        json.loads(path.read_text(), parse_constant=refuse)
    elif path.suffix == ".csv":
        with path.open(newline="") as file:
            assert not any(value.lower() in ("nan", "inf", "-inf") for row in csv.reader(file) for value in row), path
    elif path.suffix == ".tif":
        with rasterio.open(path) as file:
            assert file.nodata is not None
            assert np.all(np.isfinite(file.read(masked=True).compressed())), path
            assert all(map(math.isfinite, file.transform)), path


def assert_all_end_well(kind: str, count: int, server: CommandServer, base_seed: int = 0) -> None:
    """So many inputs of a kind end well, the same ones every time."""

    @seed(sum(map(ord, kind)) + base_seed)
    @settings(max_examples=count, database=None, suppress_health_check=list(HealthCheck), print_blob=True)
    @given(KINDS[kind])
    def run(server: CommandServer, hard: HardInput) -> None:
        check(server, hard)

    run(server)


@pytest.mark.parametrize("kind", QUICK_KINDS)
def test_a_few_hard_inputs(kind, server):
    assert_all_end_well(kind, 4, server)


@pytest.mark.hostile
def test_whole_files_are_used(server):
    """What is damaged is read where it is whole, so that damage is what is tested."""
    for name, subject in subjects().items():
        for file, content in subject.files.items():
            (server.folder / file).write_bytes(content)
        output = ["-o", f"whole {name}"] if subject.arguments[0] not in WRITE_NOTHING else []
        ended = server.run([*subject.arguments, *output], WITHIN_S)
        assert ended.code == 0, (name, ended)


@pytest.mark.hostile
@pytest.mark.parametrize("kind", KINDS)
def test_a_night_of_hard_inputs(kind, server, request):
    count = request.config.getoption("--hostile-inputs") // len(KINDS)
    assert_all_end_well(kind, count, server, request.config.getoption("--hostile-seed"))
