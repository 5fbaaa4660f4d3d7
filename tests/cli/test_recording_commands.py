"""The commands around recordings, and those that help to write a scenario."""

import json

import pytest

from sionna_radar.cli.recordings import parse_records
from sionna_radar.foundation.errors import ScenarioError

TINY = ["--set", "platform.length_m=3", "--set", "terrain.spacing_m=2", "--quiet", "--no-report"]


def test_a_recording_goes_with_the_results_and_is_processed_again(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cli("run", "hills", *TINY, "--record", "signals", "--record", "paths=seen.nc", "-o", "out")
    cli("process", "out/signals.nc", "--quiet")
    folder = tmp_path / "results" / "signals_processed"
    for name in ("dem.tif", "points.laz"):
        assert (folder / name).read_bytes() == (tmp_path / "out" / name).read_bytes()
    assert "signals.nc" in json.loads((tmp_path / "out" / "manifest.json").read_text())["files"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "results", "seen.nc"]
    # The folder may be written again, with other recordings or none; a file beside it is the user's.
    # A result of `process` is compared with the flight's own.
    cli("compare", "out", "results/signals_processed")
    refused = cli("run", "hills", *TINY, "--record", "paths=seen.nc", "-o", "out", code=2)
    assert "exists already" in refused.stderr
    cli("run", "hills", *TINY, "-o", "out")
    assert not (tmp_path / "out" / "signals.nc").exists()


@pytest.mark.parametrize(
    ("wanted", "files", "inside"),
    [
        (["signals"], {}, ["signals"]),
        (["my.nc"], {"signals": "my.nc"}, []),
        (["a/paths.nc"], {"paths": "a/paths.nc"}, []),
        (["profiles=x.nc", "paths"], {"profiles": "x.nc"}, ["paths"]),
    ],
)
def test_what_is_recorded_is_told_by_kind_or_file(wanted, files, inside):
    found, kinds = parse_records(wanted)
    assert ({kind: str(path) for kind, path in found.items()}, kinds) == (files, inside)


@pytest.mark.parametrize(
    "wanted", [["echoes"], ["signals="], ["echoes=a.nc"], ["signals", "a.nc"], ["signal"], ["paths=x/"]]
)
def test_what_is_not_recorded_is_refused(wanted):
    with pytest.raises(ScenarioError, match="--record"):
        parse_records(wanted)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["process", "nothing.nc"], "does not exist"),
        (["process", "."], "is a directory"),
        (["run", "hills", "--record", "signals", "--record-as", "int8"], "give one of float64, float32, int16"),
        (["run", "hills", "--record", "paths", "--record-as", "int16"], "has no effect without --record signals"),
        (["process", "nothing.nc", "--set", "processsing.cfar.guard=4"], "does not exist"),
        (["init", "nowhere/my.toml"], "cannot be written"),
    ],
)
def test_bad_arguments_are_one_error(cli, arguments, word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = cli(*arguments, code=2)
    assert word in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_init_writes_a_scenario_that_is_valid_and_nothing_over_one(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cli("init", "my.toml")
    cli("validate", "my.toml")
    assert "exists already" in cli("init", "my.toml", code=2).stderr


def test_schema_is_printed(cli):
    assert "platform" in json.loads(cli("schema").stdout)["required"]
