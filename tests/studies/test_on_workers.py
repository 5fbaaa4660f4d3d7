"""Studies and surveys on workers: the same bytes as in this process, whatever happens to a worker."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

import cluster_tasks
import processes
from sionna_radar.foundation.cluster import DaskWorkers, open_workers
from sionna_radar.foundation.kept_parts import FOLDER, kept_parts
from sionna_radar.report.folder import strict_json
from sionna_radar.report.sweep.products import summary
from sionna_radar.studies import sweep as sweep_module
from sionna_radar.studies.design_text import parse_design
from sionna_radar.studies.sweep import fly_sweep
from sionna_radar.studies.sweep_plan import SweepPlan, plan_sweep

BEAM = "radar.antenna.beamwidth_deg"


@pytest.fixture(scope="module")
def pair() -> Iterator[DaskWorkers]:
    with open_workers(2) as workers:
        yield workers


@pytest.fixture(scope="module")
def plan(small) -> SweepPlan:
    return plan_sweep(small, parse_design([f"{BEAM}=2,6"]), repeat=1)


def test_a_sweep_is_the_same_on_workers(pair, plan, tmp_path):
    here, counts, kept = fly_sweep(plan), [], []

    def progress(stage, done, total):
        assert stage == "surveys"
        counts.append((done, total))
        kept.append(len(list((tmp_path / FOLDER).glob("*.part"))))

    with kept_parts(tmp_path, plan.identity(), resume=False) as parts:
        there = fly_sweep(plan, workers=pair, progress=progress, parts=parts)
    assert strict_json(summary(there)) == strict_json(summary(here))
    assert counts == [(done, 2) for done in range(3)]
    assert kept == list(range(3))  # each as soon as it is there


@pytest.mark.study
def test_a_worker_that_is_killed_is_replaced_and_its_survey_flown_again(pair, small):
    """`pytest -m study -k is_killed`, half a minute."""
    plan = plan_sweep(small, parse_design([f"{BEAM}=2,6"]), repeat=4)

    def progress(stage, done, total):
        if stage == "surveys" and done in (1, 3):
            os.kill(min(pair.client.run(os.getpid).values()), signal.SIGKILL)

    there = fly_sweep(plan, workers=pair, progress=progress)
    assert strict_json(summary(there)) == strict_json(summary(fly_sweep(plan)))


@pytest.mark.study
def test_surveys_that_end_their_worker_are_rows_with_their_reason(pair, plan, monkeypatch):
    """`pytest -m study -k end_their_worker`, half a minute."""
    monkeypatch.setattr(sweep_module, "fly_trial", cluster_tasks.fly_or_die)
    found = fly_sweep(plan, workers=pair)
    assert [len(case.trials) for case in found.cases] == [1, 0]
    assert found.cases[1].reason == "seed 5: WorkerError: its worker died 3 times; is there memory enough?"


@pytest.mark.study
def test_a_signal_ends_a_sweep_and_its_workers(small, tmp_path):
    """`pytest -m study -k signal`, half a minute."""
    command = [sys.executable, "-m", "sionna_radar", "sweep", str(small), "--vary", f"{BEAM}=2,3,4,5,6"]
    out = tmp_path / "out"
    with subprocess.Popen(
        [*command, "--repeat", "20", "--workers", "2", "-o", out],
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        while not list(out.glob(f"{FOLDER}/*.part")):
            assert process.poll() is None
            time.sleep(0.05)
        began = time.monotonic()
        process.terminate()
        said = process.stderr.read()
        assert process.wait() == 143
    assert time.monotonic() - began < 5
    assert said.splitlines()[-1].endswith("the same command with --resume goes on from them")
    assert "Traceback" not in said
    assert processes.all_ended(process.pid)
