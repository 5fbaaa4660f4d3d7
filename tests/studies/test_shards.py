"""A study flown in shards and merged is the study flown at once, file by file; what does not fit is refused."""

import json
import shutil

import pytest

from blank_figures import leave_blank
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.report.files.manifest import lasting_columns
from sionna_radar.studies.sweep.document import DOCUMENT
from sionna_radar.studies.sweep.plan import Shard, plan_sweep
from sionna_radar.studies.sweep.results import read_sweep
from sionna_radar.studies.sweep.study import run_sweep


def lasting(path):
    """What the same study writes again: all but the columns of what it took."""
    return lasting_columns(path.read_bytes()) if path.name == "runs.csv" else path.read_bytes()


BEAM = "radar.antenna.beamwidth_deg"


@pytest.fixture(scope="module")
def place(small, tmp_path_factory):
    """A folder with the whole and its three shards. One of the cells cannot be flown."""
    place = tmp_path_factory.mktemp("shards")
    plan = plan_sweep(small, {BEAM: [2, 400, 6]}, repeat=2)
    DOCUMENT.write(run_sweep(plan), place / "whole")
    with pytest.MonkeyPatch.context() as patch:
        leave_blank(patch)
        for number in (1, 2, 3):
            DOCUMENT.write(run_sweep(plan, shard=Shard(number, 3)), place / str(number))
    return place


def test_merged_shards_are_the_whole_byte_for_byte(place, cli, tmp_path):
    done = cli("merge", place / "3", place / "1", place / "2", "-o", tmp_path / "merged", code=1)
    assert "1 of 3 settings failed" in done.stderr
    names = {path.relative_to(place / "whole") for path in (place / "whole").rglob("*") if path.is_file()}
    assert {p.relative_to(tmp_path / "merged") for p in (tmp_path / "merged").rglob("*") if p.is_file()} == names
    for name in names:
        assert lasting(tmp_path / "merged" / name) == lasting(place / "whole" / name), name


def test_every_survey_is_flown_in_one_shard(place):
    shards = [read_sweep(place / str(number)) for number in (1, 2, 3)]
    counts = [[len(case.trials) for case in shard.cases] for shard in shards]
    assert [sum(of_case) for of_case in zip(*counts, strict=True)] == [2, 0, 2]
    assert max(map(sum, counts)) - min(map(sum, counts)) <= 1


@pytest.mark.usefixtures("undrawn")
def test_the_command_flies_a_shard(cli, small, place, tmp_path):
    command = ("sweep", small, "--vary", f"{BEAM}=2,400,6", "--repeat", 2)
    cli(*command, "--shard", "2/3", "-o", tmp_path / "two", "-q", code=1)
    assert (tmp_path / "two" / "sweep.json").read_bytes() == (place / "2" / "sweep.json").read_bytes()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (["1", "2"], "shard 3/3 is missing"),
        (["1", "2", "2", "3"], "shard 2/3 is there twice"),
        (["1", "whole"], "holds a whole study"),
        (["1", "other"], "of different studies"),
        (["1", "damaged"], "is damaged"),
        (["1", "nowhere"], "nowhere"),
    ],
)
def test_what_is_not_all_shards_of_one_study_is_refused(place, cli, tmp_path, given, says):
    for name, change in {"other": ("repeat", 3), "damaged": ("cases", [{}])}.items():
        if name in given:
            shutil.copytree(place / "2", place / name)
            document = json.loads((place / name / "sweep.json").read_text())
            (place / name / "sweep.json").write_text(json.dumps({**document, change[0]: change[1]}))
    refused = cli("merge", *(place / name for name in given), "-o", tmp_path / "out", code=2)
    assert says in refused.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["0/3", "4/3", "1", "1/0", "a/b", "-1/3", "1/3/5", "1.5/3", ""])
def test_what_is_no_shard_is_refused(text):
    with pytest.raises(ScenarioError, match="I from 1 to N"):
        Shard.parse(text)


@pytest.mark.usefixtures("undrawn")
def test_a_finished_study_is_not_flown_again(cli, small, tmp_path, monkeypatch):
    command = ("sweep", small, "--vary", f"{BEAM}=2,400", "-o", tmp_path / "study", "--resume")
    cli(*command, code=1)  # the cell that cannot be flown
    monkeypatch.setattr("sionna_radar.studies.sweep.study.run_sweep", None)
    again = cli(*command, code=1)
    assert again.stderr == ""
    assert "nothing to do" in again.stdout
    other = cli(*command, "--seed", 9, code=2)
    assert "with another scenario, seed" in other.stderr
