"""Studies: every combination flown with every seed, what cannot be flown told in its place, interrupts survived."""

import csv
import json

import numpy as np
import pytest

from sionna_radar.execution.checkpoints import FOLDER, Checkpoints, open_checkpoints
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.interrupts import Interrupted
from sionna_radar.notebook import html_of
from sionna_radar.report.files.contents import strict_json
from sionna_radar.report.files.manifest import lasting_columns
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.sweep.document import DOCUMENT
from sionna_radar.studies.sweep.figures import figures_of
from sionna_radar.studies.sweep.plan import plan_sweep
from sionna_radar.studies.sweep.results import read_sweep
from sionna_radar.studies.sweep.settings import Axis, parse_design
from sionna_radar.studies.sweep.study import run_sweep
from sionna_radar.survey.chain import run

pytestmark = pytest.mark.usefixtures("rough_errors")

BEAM = "radar.antenna.beamwidth_deg"


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("1,2,4", (1, 2, 4)),
        ("1.5, 2", (1.5, 2)),
        ("peak,centroid", ("peak", "centroid")),
        ("[1.0, 2.0],[3.0, 4.0]", ([1.0, 2.0], [3.0, 4.0])),
        ("true,false", (True, False)),
        ("hann,[1, 2],3", ("hann", [1, 2], 3)),
    ],
)
def test_values_are_toml_and_bare_words_strings(text, values):
    assert parse_design([f"some.key={text}"]).listed == (Axis(key="some.key", values=values),)


@pytest.mark.parametrize(
    ("assignments", "says"),
    [
        (["no_value"], "not KEY=V1,V2"),
        (["=1,2"], "not KEY=V1,V2"),
        (["a.b="], "not KEY=V1,V2"),
        (["a.b=1,2", "a.b=3"], "varied twice"),
        (["a.b=x,x"], "twice"),
        (["a.b=x,,y"], "empty value"),
        ([], "nothing is varied"),
    ],
)
def test_bad_assignments_are_refused(assignments, says):
    with pytest.raises(ScenarioError, match=says):
        parse_design(assignments)


def test_every_combination_is_flown_with_seeds_in_a_row(flown):
    _, sweep, _ = flown
    assert [tuple(case.setting.values()) for case in sweep.cases] == [
        (2, "peak"),
        (2, "centroid"),
        (6, "peak"),
        (6, "centroid"),
    ]
    assert all([r.seed for r in case.trials] == [5, 6] for case in sweep.cases)
    assert len({r.points_sha256 for case in sweep.cases for r in case.trials}) == 8


def test_a_run_is_the_survey_that_run_gives(flown, small):
    _, sweep, _ = flown
    alone = run(load_scenario(small, {BEAM: 6, "processing.ranging": "centroid", "seed": 6}))
    assert sweep.cases[3].trials[1].points_sha256 == alone.points.sha256()
    assert sweep.cases[3].trials[1].dem_error == alone.dem_error


def test_progress_counts_the_surveys_and_shows_their_stages(flown):
    plan, _, calls = flown
    surveys = [(done, total) for stage, done, total in calls if stage == "surveys"]
    assert surveys == [(done, plan.trials) for done in range(plan.trials + 1)]
    assert {stage for stage, _, _ in calls} == {"surveys", "preparing", "tracing", "mapping"}


def test_statistics_are_over_the_runs(flown):
    _, sweep, _ = flown
    case = sweep.cases[0]
    first, second = (r.lit_error.rms_m for r in case.trials)
    assert case.mean("rms_m") == pytest.approx((first + second) / 2)
    assert case.spread("rms_m") == pytest.approx(abs(first - second) / np.sqrt(2))


def test_a_study_without_any_flight_is_refused(small):
    """Every combination is wrong, in ways of its own; all are told at once."""
    with pytest.raises(ScenarioError) as told:
        plan_sweep(small, parse_design([f"{BEAM}=400,900", "radar.scan.half_swath_deg=50,89.9"]))
    text = str(told.value)
    assert "400" in text
    assert "900" in text
    with pytest.raises(ScenarioError, match=r"1 problem\n  radar\.no_such_key"):
        plan_sweep(small, parse_design(["radar.no_such_key=1,2,3"]))


@pytest.mark.parametrize(
    ("repeat", "overrides", "says"),
    [(0, {}, "at least 1"), (2, {}, "seed is varied"), (1, {"seed": 3}, "both set and varied")],
)
def test_contradictory_requests_are_refused(small, repeat, overrides, says):
    with pytest.raises(ScenarioError, match=says):
        plan_sweep(small, parse_design(["seed=1,2"]), repeat, overrides)


def test_the_command_writes_table_plot_and_json(cli, small, tmp_path):
    vary = ["--vary", "processing.ranging=peak,centroid", "--vary", f"{BEAM}=2"]
    done = cli("sweep", small, *vary, "--repeat", 2, "-o", tmp_path / "out")
    assert {p.name for p in (tmp_path / "out").rglob("*") if p.is_file()} == {
        "manifest.json",
        "sweep.json",
        "table.csv",
        "runs.csv",
        "sweep.png",
    }
    document = json.loads((tmp_path / "out" / "sweep.json").read_text())
    with (tmp_path / "out" / "table.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [row["processing.ranging"] for row in table] == ["peak", "centroid"]
    for row, case in zip(table, document["cases"], strict=True):
        assert float(row["rms_m"]) == pytest.approx(case["statistics"]["rms_m"]["mean"])
        assert float(row["rms_m_spread"]) == pytest.approx(case["statistics"]["rms_m"]["spread"])
        assert f"{float(row['rms_m']):.3f}" in done.stdout
    with (tmp_path / "out" / "runs.csv").open(newline="") as file:
        assert [row["run_seed"] for row in csv.DictReader(file)] == ["5", "6", "5", "6"]


ALTITUDE = "platform.altitude_m"


@pytest.mark.usefixtures("undrawn")
def test_a_cell_that_cannot_be_flown_keeps_its_place_and_its_remedy(cli, small, tmp_path):
    wide = "terrain.size_m=[500.0, 500.0]"
    done = cli("sweep", small, "--vary", f"{ALTITUDE}=50,100", "--vary", wide, "-o", tmp_path, code=1)
    assert "radar.samples_per_chirp = 2048 works" in done.stdout
    assert "1 of 2 settings failed" in done.stderr
    flown, refused = json.loads((tmp_path / "sweep.json").read_text())["cases"]
    assert flown["reason"] is None
    assert flown["statistics"]["rms_m"]["mean"] > 0
    assert "radar.samples_per_chirp = 2048 works" in refused["reason"]
    assert refused["runs"] == []
    with (tmp_path / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["runs"], bool(row["rms_m"]), bool(row["reason"])) for row in rows] == [
        ("1", True, False),
        ("0", False, True),
    ]
    assert "nan" not in done.stdout


@pytest.mark.parametrize("failure", [MemoryError("no room"), ValueError("a bug"), OSError("a disk")])
def test_a_run_that_fails_costs_its_own_case_alone(small, monkeypatch, failure):
    plan = plan_sweep(small, parse_design([f"{BEAM}=2,4,6"]))

    def fly(scenario, **keys):
        if scenario.radar.antenna.beamwidth_deg == 4:
            raise failure
        return run(scenario, **keys)

    monkeypatch.setattr("sionna_radar.studies.sweep.trial.run", fly)
    sweep = run_sweep(plan)
    assert [bool(case.reason) for case in sweep.cases] == [False, True, False], [case.reason for case in sweep.cases]
    assert [len(case.trials) for case in sweep.cases] == [1, 0, 1]
    assert type(failure).__name__ in sweep.cases[1].reason
    assert sweep.failed
    assert not sweep.interrupted


@pytest.mark.usefixtures("undrawn")
def test_an_interrupted_command_keeps_what_it_flew_and_goes_on(cli, small, tmp_path, monkeypatch):
    """Refused without --resume; with it, nothing is flown twice, and every file is that of an uninterrupted run."""
    flown, last = [], 3

    def fly(scenario, **keys):
        if len(flown) == last:
            raise Interrupted
        flown.append(scenario)
        return run(scenario, **keys)

    def sweep(out, *more, code=0):
        return cli("sweep", small, "--vary", f"{BEAM}=2,6", "--repeat", 2, "-o", tmp_path / out, "-q", *more, code=code)

    monkeypatch.setattr("sionna_radar.studies.sweep.trial.run", fly)
    with pytest.raises(Interrupted) as interrupted:
        sweep("out")
    assert "--resume" in interrupted.value.__notes__[0]
    assert [path.name for path in (tmp_path / "out").iterdir()] == [FOLDER]
    last = 100
    refused = sweep("out", code=2)
    assert "3 finished parts of this run" in refused.stderr
    assert "--resume" in refused.stderr
    other = sweep("out", "--set", "radar.snr_db=20", "--resume", code=2)
    assert "another study, scenario" in other.stderr or "another scenario" in other.stderr
    sweep("out", "--resume")
    assert len(flown) == 4
    sweep("at_once")
    files = {path.relative_to(tmp_path / "at_once") for path in (tmp_path / "at_once").rglob("*") if path.is_file()}
    assert {path.relative_to(tmp_path / "out") for path in (tmp_path / "out").rglob("*") if path.is_file()} == files
    for name in files:
        resumed, whole = ((tmp_path / folder / name).read_bytes() for folder in ("out", "at_once"))
        if name.name == "runs.csv":
            resumed, whole = lasting_columns(resumed), lasting_columns(whole)
        assert resumed == whole, name


def test_a_study_goes_on_where_it_was_interrupted(flown, small, tmp_path):
    """Interrupted at many moments, it ends with the same results, and flies nothing twice."""
    plan, whole, _ = flown
    moments, surveys = iter(range(7, 2000, 9)), []

    def until(last):
        def progress(stage, done, total):
            nonlocal count
            count += 1
            if stage == "preparing" and done == 0:
                surveys.append(None)
            if count == last:
                raise Interrupted

        count = 0
        return progress

    interrupts = 0
    while True:
        before = len(surveys)
        try:
            with open_checkpoints(tmp_path / "out", plan.identity(), resume=True) as parts:
                there = len(parts)
                result = run_sweep(plan, execution=Execution(progress=until(next(moments)), checkpoints=parts))
                break
        except Interrupted:
            interrupts += 1
            kept = Checkpoints(tmp_path / "out" / FOLDER)
            # What was begun and is not there is the one survey that was interrupted.
            assert len(surveys) - before <= max(len(kept) - there, 0) + 1
    assert interrupts > 3
    assert result == whole
    assert strict_json(DOCUMENT.content(result)) == strict_json(DOCUMENT.content(whole))
    assert not any((tmp_path / "out").iterdir())


def test_another_study_is_another_run(flown, small, tmp_path):
    plan, _, _ = flown
    for other in (plan_sweep(small, plan.axes, repeat=3), plan_sweep(small, plan.axes, 2, {"radar.snr_db": 21.0})):
        assert other.identity() != plan.identity()
    assert plan_sweep(small, plan.axes, repeat=2).identity() == plan.identity()


def test_seeds_alone_are_a_study(small, cli, tmp_path):
    """Of one case, without a figure; once is none."""
    with pytest.raises(ScenarioError, match="nothing is varied"):
        plan_sweep(small, {})
    flown = run_sweep(plan_sweep(small, {}, repeat=2))
    assert [len(case.trials) for case in flown.cases] == [2]
    assert flown.cases[0].setting == {}
    assert figures_of(flown) == {}
    assert "<pre" in html_of(flown)
    cli("sweep", small, "--repeat", "2", "-o", tmp_path / "many")
    assert len((tmp_path / "many" / "runs.csv").read_text().splitlines()) == 3
    assert read_sweep(tmp_path / "many").cases == flown.cases
    with pytest.raises(ScenarioError, match="nothing is varied"):
        parse_design([])
