"""Studies and surveys on workers: the same bytes as in this process, whatever happens to a worker."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from sionna_radar.execution.checkpoints import FOLDER, open_checkpoints
from sionna_radar.execution.cluster import DaskWorkers, open_workers
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.errors import PluginError
from sionna_radar.foundation.threads import THREADS_VARIABLE
from sionna_radar.mapping.linear.linear import Linear
from sionna_radar.report.files.contents import strict_json
from sionna_radar.report.survey.summary import summary
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.budget.study import GRADES, navigation_errors
from sionna_radar.studies.budget.study import navigation_budget as run_budget
from sionna_radar.studies.crosscheck.study import CrossCheck
from sionna_radar.studies.crosscheck.study import crosscheck as run_crosscheck
from sionna_radar.studies.sweep.document import DOCUMENT
from sionna_radar.studies.sweep.plan import SweepPlan, plan_sweep
from sionna_radar.studies.sweep.settings import parse_design
from sionna_radar.studies.sweep.study import run_sweep
from sionna_radar.survey.chain import run
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.result import Survey

SHORT = {"platform.length_m": 12.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 48}
# Nobody but this process; or, in half a minute, workers: `pytest -m study -k the_same_on_workers`.
WHO = [None, pytest.param("pair", marks=pytest.mark.study)]
BEAM = "radar.antenna.beamwidth_deg"


@pytest.fixture(scope="module")
def pair() -> Iterator[DaskWorkers]:
    with open_workers(2) as workers:
        yield workers


@pytest.fixture(scope="module")
def plan(small) -> SweepPlan:
    return plan_sweep(small, parse_design([f"{BEAM}=2,6"]), repeat=1)


def test_a_sweep_is_the_same_on_workers(pair, plan, tmp_path):
    here, counts, kept = run_sweep(plan), [], []

    def progress(stage, done, total):
        assert stage == "surveys"
        counts.append((done, total))
        kept.append(len(list((tmp_path / FOLDER).glob("*.part"))))

    with open_checkpoints(tmp_path, plan.identity(), resume=False) as parts:
        there = run_sweep(plan, execution=Execution(workers=pair, progress=progress, checkpoints=parts))
    assert strict_json(DOCUMENT.content(there)) == strict_json(DOCUMENT.content(here))
    assert counts == [(done, 2) for done in range(3)]
    assert kept == list(range(3))  # each as soon as it is there


def test_a_survey_is_the_same_on_workers(pair, tmp_path):
    """Though it is flown in blocks of one line of the scan and of two, and what was kept is not flown again."""
    scenario = load_scenario("hills", SHORT)
    here = everything(run(scenario))
    with open_checkpoints(tmp_path / "kept", {}, resume=False) as parts:
        there = everything(run(scenario, execution=Execution(block_size=30, workers=pair, checkpoints=parts)))
        again = everything(run(scenario, execution=Execution(block_size=30, workers=Nobody(), checkpoints=parts)))
        assert len(parts) == 3
    assert there == again == here
    assert everything(run(scenario, execution=Execution(block_size=110, workers=pair))) == here


@pytest.mark.parametrize(("method", "tile"), [("refined", {"tile_m": 60.0}), ("stepped", {"tile_m": 60.0})])
def test_a_map_in_tiles_is_the_same_on_workers(pair, method, tile):
    wide = {"platform.length_m": 40.0, "platform.speed_mps": 60.0, "radar.chirp_rate_hz": 240.0, "dem.spacing_m": 2.0}
    scenario = load_scenario("hills", SHORT | wide | {"dem.method": method, "dem.method_parameters": tile})
    assert everything(run(scenario, execution=Execution(workers=pair))) == everything(run(scenario))


@pytest.mark.parametrize("who", WHO)
def test_a_budget_is_the_same_on_workers_and_goes_on(who, request, small, tmp_path):
    asked = {"errors": navigation_errors()[6:8], "grades": {"rtk": GRADES["rtk"]}, "repeat": 2}
    scenario, workers = load_scenario(small), who and request.getfixturevalue(who)
    here = run_budget(scenario, **asked)
    with open_checkpoints(tmp_path, {}, resume=False) as parts:
        assert run_budget(scenario, **asked, execution=Execution(workers=workers, checkpoints=parts)) == here
        assert run_budget(scenario, **asked, execution=Execution(workers=Nobody(), checkpoints=parts)) == here
        # A stretch of the flight, two limits and a grade.
        assert len(parts) == 4


@pytest.mark.parametrize("who", WHO)
def test_a_crosscheck_is_the_same_on_workers_and_goes_on(who, request, small, tmp_path):
    scenario, workers = load_scenario(small), who and request.getfixturevalue(who)
    here = run_crosscheck(scenario, execution=Execution(block_size=60))
    with open_checkpoints(tmp_path, {}, resume=False) as parts:
        assert bits(
            run_crosscheck(scenario, execution=Execution(block_size=30, workers=workers, checkpoints=parts))
        ) == bits(here)
        assert bits(
            run_crosscheck(scenario, execution=Execution(block_size=30, workers=Nobody(), checkpoints=parts))
        ) == bits(here)
        assert len(parts) >= 8


def test_custom_parts_are_not_for_workers(pair, small):
    with pytest.raises(PluginError, match=r"^dem\.method replaced from Python: not available on workers"):
        run(load_scenario(small), parts=CustomParts(dem_method=Linear()), execution=Execution(workers=pair))


@pytest.mark.study
def test_a_survey_is_the_same_with_any_workers_blocks_and_threads(tmp_path):
    """`pytest -m study -k any_workers`, three minutes."""
    command = [sys.executable, "-m", "sionna_radar", "run", "hills", "-q", "--set", "platform.length_m=40"]
    subprocess.run([*command, "-o", tmp_path / "whole"], check=True)
    whole = contents(tmp_path / "whole")
    ways = [(1, 256, 1), (2, 64, 1), (3, 64, 2), (4, 64, 1), (2, 1000, 4), (None, 64, 1), (None, 1000, 2)]
    for workers, block, threads in ways:
        out = tmp_path / f"{workers} {block} {threads}"
        share = [] if workers is None else ["--workers", str(workers)]
        given = os.environ | {THREADS_VARIABLE: str(threads)}
        subprocess.run([*command, *share, "--block-size", str(block), "-o", out], check=True, env=given)
        assert contents(out) == whole, (workers, block, threads)


@pytest.mark.study
def test_a_worker_that_is_killed_is_replaced_and_its_survey_flown_again(pair, small):
    """`pytest -m study -k is_killed`, half a minute."""
    plan = plan_sweep(small, parse_design([f"{BEAM}=2,6"]), repeat=4)

    def progress(stage, done, total):
        if stage == "surveys" and done in (1, 3):
            os.kill(min(pair.client.run(os.getpid).values()), signal.SIGKILL)

    there = run_sweep(plan, execution=Execution(workers=pair, progress=progress))
    assert strict_json(DOCUMENT.content(there)) == strict_json(DOCUMENT.content(run_sweep(plan)))


def bits(check: CrossCheck) -> list[bytes]:
    runs = (check.sionna, check.sionna_again, check.gamma, check.gamma_again)
    names = ("power", "range_m", "incidence_rad", "echo_range_m")
    return [column.tobytes() for run in runs for column in (*(getattr(run, n) for n in names), run.dem.height_m)]


class Nobody:
    """Workers that are never asked."""

    count = 1

    def each(self, work, tasks, shared=None):
        assert not tasks
        return iter(())


def everything(survey: Survey) -> tuple[object, ...]:
    rasters = (survey.dem, survey.dem_sigma, survey.dem_sigma_navigation, survey.error)
    heights = [None if raster is None else raster.height_m.tobytes() for raster in rasters]
    return strict_json(summary(survey)), survey.lit.tobytes(), survey.uncertainty and repr(survey.uncertainty), *heights


def contents(folder: Path) -> dict[str, bytes]:
    """Return what is in the files of a result, but for what it took."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name not in ("costs.json", "manifest.json")]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}
