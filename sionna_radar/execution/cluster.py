"""Workers of dask.distributed: local processes started for a study, or an existing cluster.

Only module-level functions (by name), JSON text and bytes are sent. Dask is imported on first use.
"""

import json
import logging
import os
import platform
import queue
import signal
import socket
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from pkgutil import resolve_name
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit
from uuid import uuid4

from sionna_radar.execution.staging import abandoned, staged
from sionna_radar.execution.workers import SHARED, Failure, InProcess, Task, Work, Workers, attempt, versions
from sionna_radar.foundation.errors import ScenarioError, WorkerError, WorkersLostError
from sionna_radar.foundation.input_file import allow_network, network_allowed
from sionna_radar.foundation.interrupts import raise_received
from sionna_radar.foundation.memory import tune_heaps
from sionna_radar.foundation.threads import THREADS_VARIABLE, cores, override_thread_limit, thread_limit

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

logger = logging.getLogger("sionna_radar")

# Deaths of its worker after which dask gives up a task of local workers; the scheduler of a cluster has its own number.
ATTEMPTS = 3
CONNECT_S = 10.0
# Seconds without workers before a warning, and to wait after it.
WARN_AFTER_S, FIRST_WORKER_S = 3.0, 30.0
# Polling interval for interrupts.
TICK_S = 0.2
CLOSING_S = 2.0
# The tracer and the thread pools are shared by a process, so each worker runs one task at a time.
_one_at_a_time = threading.Lock()


@contextmanager
def open_workers(count: int | None = None, scheduler: str | None = None) -> Iterator[Workers]:
    """Yield workers: processes on this machine, an existing cluster, or this process itself.

    Parameters
    ----------
    count:
        Processes to start; they share the cores. While they are idle, this process may use all of their threads.
    scheduler:
        Address of a dask scheduler, tcp://HOST:PORT.

    Returns
    -------
    A context manager of the workers, which end with it.

    Raises
    ------
    ScenarioError
        `count` and `scheduler` are both given, or `count` is less than 1.
    WorkerError
        Dask is not installed, or no cluster answers at the address. Versions are compared with each task.

    Examples
    --------
    >>> with open_workers() as workers:
    ...     workers.count
    0
    """
    if count is not None and scheduler is not None:
        _refuse("--workers", "both --workers and --scheduler are given; choose one")
    if count is not None and count < 1:
        _refuse("--workers", f"{count} workers do nothing; give at least 1, or leave it out")
    if count is None and scheduler is None:
        yield InProcess()
        return
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise WorkerError("workers need dask; install it with `pip install 'sionna-radar[cluster]'`") from error
    # Dask's connection messages concern cluster operators, and some arrive after the run; its loggers have their own
    # levels.
    for name in [name for name in logging.root.manager.loggerDict if name.split(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    opened = _local_client(count) if count is not None else _remote_client(str(scheduler))
    with opened as client:
        yield DaskWorkers(client=client, program={} if count else versions(), local=count or 0)


@contextmanager
def _local_client(count: int) -> Iterator["Client"]:
    import dask
    from distributed import Client, LocalCluster

    given = thread_limit()
    threads = given or max(cores() // count, 1)
    settings = {
        # Dask would override the thread settings of BLAS; the number of threads is set below.
        "distributed.nanny.pre-spawn-environ": dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"),
        "distributed.worker.multiprocessing-method": "spawn",
        "distributed.scheduler.worker-ttl": None,
        # On a busy machine a new process takes longer than the 30 s in which dask connects to it, and the 15 s after
        # which it gives up a worker that has ended.
        "distributed.comm.timeouts.connect": "300s",
        "distributed.deploy.lost-worker-timeout": "1h",
    }
    _start_silent_tracker()
    temporary = Path(tempfile.gettempdir())
    for _ in abandoned(temporary):
        pass
    # The settings hold as long as the workers live: dask reads some of them when one ends.
    with staged(temporary) as place, dask.config.set(settings | {"temporary-directory": str(place)}):
        cluster = LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            memory_limit=None,
            local_directory=str(place),
            silence_logs=logging.CRITICAL,
            scheduler_kwargs={
                "allowed_failures": ATTEMPTS - 1,
                # The dashboard cannot be disabled: use a free port and no plotting dependencies.
                "dashboard": False,
                "dashboard_address": "127.0.0.1:0",
            },
            env={THREADS_VARIABLE: str(threads)},
            preload=[__name__],
        )
        try:
            with Client(cluster, set_as_default=False) as client, override_thread_limit(given and count * given):
                yield client
        finally:
            _end(cluster)


def _start_silent_tracker() -> None:
    """Start Python's resource tracker without its warnings about semaphores of killed runs."""
    from multiprocessing import resource_tracker

    sys.warnoptions.append("ignore:resource_tracker")
    try:
        resource_tracker.ensure_running()
    finally:
        sys.warnoptions.pop()


def dask_setup(_: Any) -> None:
    """Set up a worker: ignore Ctrl-C (the parent shuts it down), and tune heaps."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tune_heaps()


def _end(cluster: "LocalCluster") -> None:
    """Kill the worker processes; all finished results have been received."""
    for nanny in list(cluster.workers.values()):
        nanny.auto_restart = False
        process = getattr(nanny, "process", None)
        pid = process.pid if process is not None else None
        if pid is not None:
            with suppress(ProcessLookupError):
                os.kill(pid, getattr(signal, "SIGKILL", signal.SIGTERM))
    with suppress(TimeoutError):
        cluster.close(timeout=CLOSING_S)


@contextmanager
def _remote_client(address: str) -> Iterator["Client"]:
    from distributed import Client

    try:
        # Dask may hang on a second failed connection, so check the port first.
        host, port = _host_and_port(address)
        socket.create_connection((host, port), timeout=CONNECT_S).close()
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        message = f"--scheduler: no dask scheduler answers at {address!r} ({error}); give tcp://HOST:PORT of one"
        raise WorkerError(message) from error
    with client:
        try:
            _wait_for_first(client)
        except TimeoutError as error:
            message = f"--scheduler: the cluster at {address} has no workers; start some with `dask worker {address}`"
            raise WorkerError(message) from error
        except OSError as error:
            raise WorkersLostError("the dask scheduler is gone") from error
        yield client


def _wait_for_first(client: "Client") -> None:
    try:
        client.wait_for_workers(1, timeout=WARN_AFTER_S)
    except TimeoutError:
        logger.warning("the cluster has no worker yet; waiting %g s for one", FIRST_WORKER_S)
        client.wait_for_workers(1, timeout=FIRST_WORKER_S)


def _host_and_port(address: str) -> tuple[str, int]:
    found = urlsplit(address)
    if found.scheme != "tcp" or not found.hostname or not found.port:
        raise ValueError("this is no such address")
    return found.hostname, found.port


@dataclass(frozen=True, kw_only=True)
class DaskWorkers:
    """The workers of a cluster, or so many local processes; `program`: versions of packages that they must have."""

    client: "Client"
    program: Mapping[str, Any]
    local: int

    @property
    def count(self) -> int:
        """Number of tasks run concurrently."""
        return self.local or max(self._worker_count(), 1)

    def _worker_count(self) -> int:
        try:
            return len(self.client.nthreads())
        except OSError as error:
            raise WorkersLostError("the dask scheduler is gone") from error

    def each(self, work: Work, tasks: Sequence[Task], shared: Any = None) -> Iterator[tuple[int, bytes | Failure]]:
        """Yield the result or failure of each task as it finishes; dask retries a task whose worker has died."""
        finished: queue.SimpleQueue[Future] = queue.SimpleQueue()
        running: dict[Future, int] = {}
        waiting: Iterator[int] = iter(range(len(tasks)))
        unfinished = len(tasks)
        given = {
            "name": f"{work.__module__}:{work.__qualname__}",
            "program": dict(self.program),
            "network": network_allowed(),
        }
        payload = None if shared is None or not tasks else self._sent(shared)
        try:
            while unfinished:
                # No more than run at once: dask blames all tasks of a worker for its death.
                for number in islice(waiting, self.count - len(running)):
                    task, key = json.dumps(tasks[number]), f"sionna-radar-{uuid4().hex}"
                    future = self.client.submit(perform, task, json.dumps(given), payload, key=key, pure=False)
                    running[future] = number
                    future.add_done_callback(finished.put)
                future = self._next(finished)
                number = running.pop(future)
                try:
                    result = _result(future)
                except TimeoutError:  # its worker died as the result was fetched, and dask may wait for it for ever
                    future.cancel(reason="it is run again")
                    waiting = chain([number], waiting)
                    continue
                unfinished -= 1
                yield number, result
        finally:
            for future in running:
                future.cancel(reason="the study has ended")

    def _sent(self, shared: bytes) -> "Future":
        """Return the shared payload as a dask task, so that dask recreates it if the worker that holds it is lost."""
        with warnings.catch_warnings():
            # Dask warns about large payloads and suggests a shared file.
            warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
            sent = self.client.submit(_itself, shared, key=f"sionna-radar-{uuid4().hex}", pure=False)
        arrived: queue.SimpleQueue[Future] = queue.SimpleQueue()
        sent.add_done_callback(arrived.put)
        self._next(arrived)
        # Dask prefers workers that hold what a task needs: without copies the others get little to do.
        with suppress(Exception):  # a worker that has just died; the tasks run all the same
            self.client.replicate([sent])
        return sent

    def _next(self, finished: "queue.SimpleQueue[Future]") -> "Future":
        """Return the next finished task; interrupts are handled while waiting."""
        since, told = monotonic(), False
        while True:
            raise_received()
            if self.client.status not in ("running", "connecting"):
                raise WorkersLostError("the dask scheduler is gone")
            try:
                future = finished.get(timeout=TICK_S)
            except queue.Empty:
                if monotonic() - since > WARN_AFTER_S and not self._worker_count():
                    since = monotonic()
                    if self.local:
                        self._restart_lost()
                    elif not told:
                        told = True
                        logger.warning("the cluster has no worker any more; waiting for one")
                continue
            if future.status != "lost":
                return future
            # The worker that held its result has died, and dask runs the task again.
            sleep(TICK_S)
            finished.put(future)

    def _restart_lost(self) -> None:
        """Start new local workers if all have ended for good.

        Dask restarts a worker that ends, but gives up when the new process does not connect in time.
        """
        from distributed.core import Status

        cluster = self.client.cluster
        if all(nanny.status in (Status.closed, Status.failed) for nanny in cluster.workers.values()):
            cluster.scale(len(cluster.worker_spec) + self.local)


def _result(future: "Future") -> bytes | Failure:
    """Return the result or failure of a task, and log its messages here; TimeoutError if its result does not come."""
    from distributed import KilledWorker

    if future.status == "cancelled":
        raise WorkersLostError("the dask scheduler has lost a task: it has stopped or was restarted")
    if future.status == "error":
        error = future.exception()
        if isinstance(error, KilledWorker):
            text = f"its worker died {error.allowed_failures + 1} times; is there memory enough?"
            return Failure(kind=WorkersLostError.__name__, text=text)
        if isinstance(error, WorkerError):
            raise error
        message = f"a worker cannot run this program ({type(error).__name__}: {error}); install the same version there"
        raise WorkerError(message) from error
    reply = future.result(timeout=FIRST_WORKER_S)
    for level, text in reply["log"]:
        logger.log(level, "%s", text)
    failure = reply["failure"]
    return reply["result"] if failure is None else Failure.of_document(failure)


def _itself(shared: bytes) -> bytes:
    return shared


def perform(task: str, document: str, shared: bytes | None) -> dict[str, Any]:
    """Run a task in a worker; return its result or failure, and its warnings. WorkerError for other versions."""
    settings, log = json.loads(document), _Log()
    if settings["program"]:
        _check_versions(settings["program"])
    with _one_at_a_time, log.listening(), allow_network() if settings["network"] else nullcontext():
        found = attempt(resolve_name(settings["name"]), {**json.loads(task), SHARED: shared})
    if isinstance(found, Failure):
        return {"result": None, "failure": found.document(), "log": log.records}
    return {"result": found, "failure": None, "log": log.records}


def _check_versions(program: Mapping[str, Any]) -> None:
    here = versions()
    different = [f"{name} {here[name]} in place of {program[name]}" for name in program if here[name] != program[name]]
    if different:
        message = f"the worker at {platform.node()} has {', '.join(different)}; install the same versions there"
        raise WorkerError(f"--scheduler: {message}")


class _Log(logging.Handler):
    """Collect the warnings logged by the package."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.records: list[tuple[int, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append((record.levelno, record.getMessage()))

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Collect log records instead of printing them."""
        propagate = logger.propagate
        logger.addHandler(self)
        logger.propagate = False
        try:
            yield
        finally:
            logger.removeHandler(self)
            logger.propagate = propagate


def _refuse(field: str, message: str) -> None:
    raise ScenarioError.of_option(field, message)
