"""Tasks give the same results in this process and on workers; what fails, or ends its worker, costs itself alone."""

import asyncio
import json
import logging
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import cluster_tasks
from cluster_tasks import look
from processes import all_ended
from sionna_radar.execution.checkpoints import open_checkpoints
from sionna_radar.execution.cluster import DaskWorkers, open_workers
from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import Failure, InProcess
from sionna_radar.foundation.errors import ScenarioError, WorkerError, WorkersLostError
from sionna_radar.foundation.input_file import allow_network
from sionna_radar.foundation.threads import THREADS_VARIABLE, cores

TASKS = [{"do": "look", "x": 0.1}, {"do": "refuse"}, {"do": "look", "x": math.nan}, {"do": "fail"}]


@pytest.fixture(scope="module")
def pair():
    with open_workers(2) as workers:
        yield workers


def seen(found):
    return found if isinstance(found, Failure) else {**json.loads(found), "pid": 0, "cores": 0}


def test_nobody_but_this_process_needs_no_dask():
    """Neither does the command line, as long as it is not asked to share its work."""
    code = (
        "import sys; from sionna_radar.execution.cluster import open_workers; import sionna_radar.cli.app\n"
        "with open_workers() as workers: print(workers.count, 'dask' in sys.modules, 'distributed' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0", "False", "False"]


def test_workers_give_what_this_process_gives(pair):
    here, there = ({n: seen(found) for n, found in workers.each(look, TASKS)} for workers in (InProcess(), pair))
    assert repr(sorted(here.items())) == repr(sorted(there.items()))
    refused, failed = there[1], there[3]
    assert (refused.kind, refused.text) == ("ScenarioError", "some.key: 1 is refused; give 2")
    with pytest.raises(ScenarioError, match=r"1 problem\n  some\.key: 1 is refused"):
        raise refused.error()
    with pytest.raises(WorkerError, match="KeyError: 'fail'"):
        raise failed.error()
    assert isinstance(here[3].error(), KeyError)


def test_the_cores_are_shared_and_the_work_is_done_elsewhere(pair):
    found = [json.loads(result) for _, result in pair.each(look, [{"do": "look", "x": n} for n in range(6)])]
    assert {one["cores"] for one in found} == {max(cores() // 2, 1)}
    assert {one["x"] for one in found} == set(range(6))
    assert os.getpid() not in {one["pid"] for one in found}


def test_while_workers_wait_this_process_has_the_threads_of_all(monkeypatch):
    monkeypatch.setenv(THREADS_VARIABLE, "1")
    assert cores() == 1
    with open_workers(2) as workers:
        assert cores() == min(2, os.cpu_count() or 1)
        assert {json.loads(found)["cores"] for _, found in workers.each(look, TASKS[:1] * 2)} == {1}
    assert cores() == 1


def test_warnings_and_the_leave_to_reach_the_network_travel(pair, caplog):
    with caplog.at_level(logging.WARNING), allow_network():
        (_, there), *_ = pair.each(look, [{"do": "warn", "x": 0}])
    assert json.loads(there)["network"]
    assert caplog.messages == ["mind this"]
    (_, there), *_ = pair.each(look, TASKS[:1])
    assert not json.loads(there)["network"]


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_task_that_ends_its_worker_three_times_is_given_up_and_the_others_are_done(pair, tmp_path):
    deadly = {"do": "die", "deaths": str(tmp_path / "deaths")}
    tasks = {f"{n}": {"do": "look", "x": n} for n in range(5)} | {"deadly": deadly}
    with open_checkpoints(tmp_path / "out", {}, resume=False) as parts:
        found = dict(Execution(workers=pair, checkpoints=parts).over(dict(reversed(tasks.items())), look))
        assert len(parts) == 5
        assert parts.get("deadly") is None
    assert found["deadly"] == Failure(kind="WorkersLostError", text="its worker died 3 times; is there memory enough?")
    assert [seen(found[f"{n}"])["x"] for n in range(5)] == list(range(5))
    assert len((tmp_path / "deaths").read_text().split()) == 3


def test_a_task_whose_result_never_comes_is_run_again(pair, monkeypatch):
    """Its worker may die while the result is fetched."""
    from distributed import Future

    fetch, lost = Future.result, []

    def result(self, timeout=None):
        assert timeout is not None, "would wait for ever"
        if len(lost) < 2:
            lost.append(self.key)
            raise TimeoutError
        return fetch(self, timeout)

    monkeypatch.setattr(Future, "result", result)
    found = dict(pair.each(look, [{"do": "look", "x": n} for n in range(5)]))
    assert [json.loads(found[n])["x"] for n in range(5)] == list(range(5))
    assert len(set(lost)) == 2


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_workers_that_dask_gives_up_to_restart_are_started_anew(tmp_path, monkeypatch):
    """On a busy machine the new process may not connect in time, after which dask closes its nanny for good."""
    from distributed.nanny import WorkerProcess

    starts, connected = [], WorkerProcess._wait_until_connected

    async def too_late_once(self, *given):
        starts.append(self)
        if starts == [self, self]:
            raise TimeoutError
        return await connected(self, *given)

    monkeypatch.setattr(WorkerProcess, "_wait_until_connected", too_late_once)
    monkeypatch.setattr("sionna_radar.execution.cluster.WARN_AFTER_S", 0.5)
    tasks = [{"do": "die", "deaths": str(tmp_path / "deaths")}, {"do": "look", "x": 7}]
    with open_workers(1) as workers:
        found = dict(workers.each(look, tasks))
    assert len(starts) > 2
    assert found[0] == Failure(kind="WorkersLostError", text="its worker died 3 times; is there memory enough?")
    assert seen(found[1])["x"] == 7


@pytest.mark.study
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_worker_may_take_longer_to_start_again_than_dask_waits(tmp_path, monkeypatch):
    from distributed import Nanny

    started = Nanny.instantiate

    async def late(self):
        await asyncio.sleep(20.0 if self.process is not None else 0.0)
        return await started(self)

    monkeypatch.setattr(Nanny, "instantiate", late)
    monkeypatch.setattr(DaskWorkers, "_restart_lost", lambda _: None)
    monkeypatch.setattr("sionna_radar.execution.cluster.ATTEMPTS", 1)
    tasks = [{"do": "die", "deaths": str(tmp_path / "deaths")}, {"do": "look", "x": 7}]
    with open_workers(1) as workers:
        found = dict(workers.each(look, tasks))
    assert seen(found[1])["x"] == 7


@pytest.mark.parametrize(
    ("count", "scheduler", "says"),
    [(0, None, "0 workers do nothing"), (2, "tcp://127.0.0.1:1", "both --workers and --scheduler")],
)
def test_contradictory_requests_are_refused(count, scheduler, says):
    with pytest.raises(ScenarioError, match=says), open_workers(count, scheduler):
        pass


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:1", "nowhere", "tcp://nowhere.invalid:8786", "http://a:1", "tcp://a:x", ""]
)
def test_an_address_without_a_scheduler_is_one_clear_error(address, monkeypatch):
    monkeypatch.setattr("sionna_radar.execution.cluster.CONNECT_S", 0.3)
    with pytest.raises(WorkerError, match="no dask scheduler answers at"), open_workers(None, address):
        pass


def test_a_cluster_that_is_there_must_have_the_same_program(pair, monkeypatch):
    address = pair.client.scheduler.address
    with open_workers(None, address) as workers:
        assert workers.count >= 1  # another test may just have ended one of the two
        assert [seen(found)["x"] for _, found in workers.each(look, TASKS[:1])] == [0.1]
    monkeypatch.setattr("sionna_radar.execution.cluster.versions", lambda: {"numpy": "0.1"})
    with (
        pytest.raises(WorkerError, match=r"has numpy .* in place of 0\.1"),
        open_workers(None, address) as workers,
    ):
        next(workers.each(look, TASKS[:1]))


@pytest.mark.parametrize("text", ["0", "many", "-1", ""])
def test_a_wrong_number_of_threads_is_refused(monkeypatch, text):
    monkeypatch.setenv(THREADS_VARIABLE, text)
    with pytest.raises(ScenarioError, match=THREADS_VARIABLE):
        cores()


INTERRUPTED = """
import signal
import sys
from pathlib import Path
import cluster_tasks
from cluster_tasks import look
from sionna_radar.execution.cluster import open_workers
from sionna_radar.foundation.interrupts import interrupts_reported
from sionna_radar.execution.checkpoints import open_checkpoints
from sionna_radar.execution.execution import Execution

if __name__ == "__main__":
    # Ignored in what a shell starts in the background.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    tasks = {str(n): {"do": "look", "x": n} for n in range(2)} | {f"slow {n}": {"do": "sleep"} for n in range(9)}
    checkpoints = open_checkpoints(Path(sys.argv[1]), {}, resume=False)
    with interrupts_reported(), open_workers(2) as workers, checkpoints as parts:
        for _ in Execution(workers=workers, checkpoints=parts).over(tasks, look):
            print("done", flush=True)
"""


@pytest.mark.parametrize(
    ("number", "code"), [pytest.param(signal.SIGTERM, 143, marks=pytest.mark.study), (signal.SIGINT, 130)]
)
def test_a_signal_ends_all_processes_and_says_how_to_go_on(tmp_path, number, code):
    """Ctrl-C reaches every process of the terminal, SIGTERM the one that is named."""
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED)
    began = {"start_new_session": True, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    paths = {"PYTHONPATH": str(Path(cluster_tasks.__file__).parent), "TMPDIR": str(tmp_path)}
    command = [sys.executable, script, tmp_path / "out"]
    with subprocess.Popen(command, env=os.environ | paths, **began) as process:
        assert [process.stdout.readline() for _ in range(2)] == ["done\n"] * 2
        (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
        # Less than the slow tasks take, which are not waited for.
        _, said = process.communicate(timeout=50)
    assert process.returncode == code, said
    assert said == "interrupted; finished tasks are saved; continue with the same command and --resume\n"
    assert all_ended(process.pid)
    assert {path.name for path in tmp_path.iterdir()} == {"script.py", "out"}


CLUSTER = """
import sys, time
from distributed import LocalCluster
if __name__ == "__main__":
    there = {"protocol": "tcp", "host": "127.0.0.1", "dashboard_address": None}
    with LocalCluster(n_workers=int(sys.argv[1]), processes=False, **there) as cluster:
        print(cluster.scheduler_address, flush=True)
        time.sleep(120)
"""


@pytest.fixture
def cluster_of(tmp_path):
    """Return what starts a cluster of so many workers in a process of its own."""
    (tmp_path / "cluster.py").write_text(CLUSTER)
    paths = {"PYTHONPATH": str(Path(cluster_tasks.__file__).parent)}
    started = []

    def start(workers):
        command = [sys.executable, tmp_path / "cluster.py", str(workers)]
        process = subprocess.Popen(command, env=os.environ | paths, stdout=subprocess.PIPE, text=True, cwd=tmp_path)
        started.append(process)
        return process, process.stdout.readline().strip()

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_a_cluster_without_workers_is_told_of_before_it_is_given_up(cluster_of, monkeypatch, caplog):
    monkeypatch.setattr("sionna_radar.execution.cluster.WARN_AFTER_S", 0.1)
    monkeypatch.setattr("sionna_radar.execution.cluster.FIRST_WORKER_S", 0.2)
    _, address = cluster_of(0)
    with pytest.raises(WorkerError, match="has no workers; start some with"), open_workers(None, address):
        pass
    assert caplog.messages == ["the cluster has no worker yet; waiting 0.2 s for one"]


def test_a_scheduler_that_dies_before_it_has_workers_is_one_error(cluster_of, monkeypatch):
    process, address = cluster_of(0)

    def gone(client, count, timeout):
        process.kill()
        process.wait()
        raise OSError("Timed out trying to connect")  # as dask says ten seconds later

    monkeypatch.setattr("distributed.Client.wait_for_workers", gone)
    with pytest.raises(WorkersLostError, match="the dask scheduler is gone"), open_workers(None, address):
        pass


def test_a_scheduler_that_dies_is_one_error(cluster_of, caplog):
    process, address = cluster_of(1)
    with open_workers(None, address) as workers:
        results = workers.each(look, [{"do": "look", "x": 0}, {"do": "sleep"}])
        next(results)
        process.kill()
        with pytest.raises(WorkersLostError, match="the dask scheduler"):
            next(results)
    assert [record for record in caplog.records if record.levelno < logging.CRITICAL] == []


KILLED = """
import os, signal
from sionna_radar.execution.cluster import open_workers
if __name__ == "__main__":
    with open_workers(2):
        os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_run_left_in_the_temporary_folder_the_next_one_removes(tmp_path, monkeypatch):
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    folder = tmp_path / "temporary"
    folder.mkdir()
    began = {"start_new_session": True, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, script], env=os.environ | {"TMPDIR": str(folder)}, **began) as process:
        _, said = process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert said == ""
    assert all_ended(process.pid)
    assert len(list(folder.iterdir())) == 1
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    with open_workers(1) as workers:
        assert [seen(found)["x"] for _, found in workers.each(look, TASKS[:1])] == [0.1]
        assert len(list(folder.iterdir())) == 1
    assert list(folder.iterdir()) == []
