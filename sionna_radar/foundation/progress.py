"""Progress reports, remaining time, stage times, and memory of long computations.

Progress and time are reported like log messages: from anywhere, to the listener and the stopwatch of the context.
"""

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from itertools import pairwise
from time import perf_counter
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from sionna_radar.foundation.interrupts import raise_received

if TYPE_CHECKING:
    from rich.console import Console


# Called at the start of a stage and after each of its steps with the stage's name, the steps done, and the total number
# of steps, 0 if unknown.
Progress = Callable[[str, int, int], None]
# Shortest interval between two updates of a notebook's bar, s.
REDRAW_INTERVAL_S = 0.2
# The remaining time is estimated only after this time (s) and fraction of a stage, and only if no single wait takes a
# larger fraction of the time of the last half of its steps. Tried on the stages of a flight over San Francisco, with
# and without compilation.
MIN_TIMED_S, MIN_TIMED_SHARE, MAX_WAIT = 3.0, 0.05, 0.25
# Most time stamps that are kept of a stage.
MAX_TIMES = 200


def silent(stage: str, done: int, total: int) -> None:
    """Report nothing."""


class _Stage:
    """A stage of a computation, and how many of its steps are done; a total of 0 is unknown."""

    def __init__(self, name: str, total: int) -> None:
        self.name, self.total, self.done = name, total, 0

    def report(self) -> None:
        report(self.name, self.done, self.total)


_listener: ContextVar[Progress] = ContextVar("listener", default=silent)
_current: ContextVar[_Stage | None] = ContextVar("current stage", default=None)


class RemainingTime:
    """Estimates the remaining time of each stage from the pace of its last steps.

    The first steps wait for compilation and for files, and do not predict later ones; nor do steps that come in bursts
    with long waits between.
    """

    def __init__(self) -> None:
        self._times: dict[str, list[tuple[int, float]]] = {}

    def seconds(self, stage: str, done: int, total: int, now_s: float) -> float | None:
        """Return the remaining time after a step, s; None while it is uncertain by more than about a factor of two."""
        if total == 0:
            return None
        times = self._times.setdefault(stage, [(done, now_s)])
        if done == 0 or done < times[-1][0]:  # it began, or began again
            times[:] = [(done, now_s)]
        if done - times[-1][0] >= total / MAX_TIMES:
            times.append((done, now_s))
        steps = done - times[0][0]
        if steps < max(MIN_TIMED_SHARE * total, 1):
            return None
        begin = max(k for k, (before, _) in enumerate(times) if done - before >= steps / 2)
        first, start_s = times[begin]
        moments = [moment_s for _, moment_s in times[begin:]] + [now_s]
        waits = [after - before for before, after in pairwise(moments)]
        if now_s - start_s < MIN_TIMED_S or max(waits) > MAX_WAIT * (now_s - start_s):
            return None
        return (total - done) * (now_s - start_s) / (done - first)

    def text(self, stage: str, done: int, total: int, now_s: float) -> str:
        """Return the remaining time as text; empty while it is unknown."""
        left_s = self.seconds(stage, done, total, now_s)
        if left_s is None or done >= total:
            return ""
        return f"about {left_s:.0f} s left" if left_s < 120 else f"about {left_s / 60:.0f} min left"


@contextmanager
def progress_to(listener: Progress) -> Iterator[None]:
    """Report the progress of this context to a listener; steps do not count for stages outside of it."""
    listening, stage_before = _listener.set(listener), _current.set(None)
    try:
        yield
    finally:
        _listener.reset(listening)
        _current.reset(stage_before)


def report(stage: str, done: int, total: int) -> None:
    """Report the steps of a stage that are done to the listener; total 0 if unknown."""
    raise_received()
    _listener.get()(stage, done, total)


@contextmanager
def stage(name: str, total: int = 0) -> Iterator[None]:
    """Compute a stage, whose steps are counted by `advance`; without an exception it ends with all of them done.

    name: text that is displayed.
    total: number of steps; 0 if unknown, or until `expect_steps` gives it.
    """
    current = _Stage(name, total)
    current.report()
    before = _current.set(current)
    try:
        yield
    finally:
        _current.reset(before)
    if current.done != current.total or current.done == 0:
        current.done = current.total = max(current.done, current.total, 1)
        current.report()


def expect_steps(total: int) -> None:
    """Set the number of steps of the current stage, none of which is done."""
    current = _current.get()
    if current is not None:
        current.done, current.total = 0, total
        current.report()


def advance(count: int = 1) -> None:
    """Count steps of the current stage, and raise an interrupt that has come.

    In the threads of a pool there is no stage; see `foundation.threads.several_at_once`.
    """
    raise_received()
    current = _current.get()
    if current is not None and count > 0:
        current.done += count
        current.report()


def steps_done() -> int:
    """Return the number of steps of the current stage that are done."""
    current = _current.get()
    return 0 if current is None else current.done


@contextmanager
def shown_progress(listener: Progress | None) -> Iterator[None]:
    """Report to a listener; without one to a bar in a notebook, and in a script to whoever listens already."""
    if listener is not None:
        with progress_to(listener):
            yield
    elif in_notebook() and _listener.get() is silent:
        with notebook_bar() as bar, progress_to(bar):
            yield
    else:
        yield


def in_notebook() -> bool:
    """Return True if this runs in a Jupyter kernel."""
    if "IPython" not in sys.modules:
        return False
    from IPython import get_ipython

    return type(get_ipython()).__name__ == "ZMQInteractiveShell"


@contextmanager
def notebook_bar() -> Iterator[Progress]:
    """Yield a progress callback that draws one bar below a notebook's cell, and removes it at the end.

    It is no widget, which would stay behind without its model, and all runs of a cell share its place.
    """
    from IPython import get_ipython

    shell = get_ipython()
    handle = _place_below(shell, shell.execution_count)
    remaining, drawn_s = RemainingTime(), -math.inf

    def show(stage: str, done: int, total: int) -> None:
        nonlocal drawn_s
        raise_received()
        now_s = time.monotonic()
        until_end = remaining.text(stage, done, total, now_s)
        if done > 0 and now_s < drawn_s + REDRAW_INTERVAL_S:
            return
        drawn_s = now_s
        words = ", ".join(filter(None, [f"{stage} {done:,}/{total:,}" if total and done else stage, until_end]))
        filled = f' value="{done}" max="{total}"' if total else ""
        handle.update({"text/html": f"<progress{filled}></progress> {words}", "text/plain": words}, raw=True)

    try:
        yield show
    finally:
        handle.update({"text/plain": ""}, raw=True)


@lru_cache(maxsize=1)
def _place_below(shell: Any, cell: int) -> Any:
    """Return the handle of an empty output of a shell's cell, by the count of executions."""
    from IPython.display import display

    return display({"text/plain": ""}, raw=True, display_id=True)


@contextmanager
def progress_bar(console: "Console") -> Iterator[Progress]:
    """Yield a progress callback that draws a bar for each stage on a console."""
    from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    counted = (TextColumn("{task.description:>10}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Bars(*counted, TextColumn("{task.fields[left]}"), console=console, transient=True) as bars:
        tasks: dict[str, TaskID] = {}
        remaining = RemainingTime()

        def show(stage: str, done: int, total: int) -> None:
            raise_received()
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=None, left="")
            elif done == 0:
                bars.reset(tasks[stage])
            until_end = remaining.text(stage, done, total, time.monotonic())
            bars.update(tasks[stage], completed=done, total=total or None, left=until_end)

        yield show


class Stopwatch:
    """Adds up the time of stages that may run many times."""

    def __init__(self) -> None:
        self._start = perf_counter()
        self._spent: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Add the time of a block to a stage."""
        start = perf_counter()
        try:
            yield
        finally:
            self._spent[stage] = self._spent.get(stage, 0.0) + perf_counter() - start

    def seconds(self) -> dict[str, float]:
        """Return the seconds of each stage, and under `total` those since the stopwatch was created."""
        return {**self._spent, "total": perf_counter() - self._start}


_stopwatch: ContextVar[Stopwatch | None] = ContextVar("stopwatch", default=None)


@contextmanager
def timing() -> Iterator[Stopwatch]:
    """Yield a stopwatch that adds up what is `timed` in this context."""
    watch = Stopwatch()
    before = _stopwatch.set(watch)
    try:
        yield watch
    finally:
        _stopwatch.reset(before)


@contextmanager
def timed(stage: str) -> Iterator[None]:
    """Add the time of a block to a stage of the context's stopwatch."""
    watch = _stopwatch.get()
    if watch is None:
        yield
        return
    with watch(stage):
        yield


# Parameters of glibc's `mallopt` (malloc.h) and their values: the number of heaps that threads share, the free memory
# that a heap keeps at its end, and the size from which an array is mapped separately (the largest that glibc allows).
M_ARENA_MAX, ARENAS = -8, 2
M_TRIM_THRESHOLD, KEPT_BYTES = -1, 256 << 20
M_MMAP_THRESHOLD, LARGE_BYTES = -3, 32 << 20


def tune_heaps() -> None:
    """Configure malloc for blocks of pulses; no effect where the C library has no such settings.

    All threads allocate from few heaps. By default glibc gives each thread its own, up to eight a core, and what one
    thread frees, the others cannot use: the blocks of a long flight then hold tens of megabytes that are free.

    What a block frees is kept for the next one. By default much of it goes back to the system, and fresh pages cost as
    much as what is written into them: of a wavefront of a million rays, a third of the time.
    """
    import ctypes

    try:
        setting = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library; Windows
        return
    setting(M_ARENA_MAX, ARENAS)
    setting(M_TRIM_THRESHOLD, KEPT_BYTES)
    setting(M_MMAP_THRESHOLD, LARGE_BYTES)


def release_memory() -> None:
    """Return free memory to the operating system; no effect where the C library cannot.

    Many small blocks leave fragmented memory, in which large arrays do not fit.
    """
    import ctypes

    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # another C library; Windows
        return
    trim(0)


@runtime_checkable
class HoldsMemory(Protocol):
    """A component that keeps arrays for its next call."""

    def release_memory(self) -> None:
        """Release them until the next call."""


def peak_memory_mb() -> float:
    """Return the largest resident memory of this process so far; NaN where the system does not report it."""
    try:
        import resource
    except ImportError:
        return float("nan")
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
