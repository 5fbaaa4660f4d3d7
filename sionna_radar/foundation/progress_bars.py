"""Bars that show progress, in a notebook and on a console, with the time that is left."""

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from sionna_radar.foundation.interrupts import raise_received

if TYPE_CHECKING:
    from rich.console import Console

from sionna_radar.foundation.progress import Progress, _listener, progress_to, silent

# Shortest interval between two updates of a notebook's bar, s.
REDRAW_INTERVAL_S = 0.2
# The remaining time is estimated only after this time (s) and fraction of a stage, and only if no single wait takes a
# larger fraction of the time of the last half of its steps. Tried on the stages of a flight over San Francisco, with
# and without compilation.
MIN_TIMED_S, MIN_TIMED_SHARE, MAX_WAIT = 3.0, 0.05, 0.25
# Most time stamps that are kept of a stage.
MAX_TIMES = 200


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
        """Redraw the bar, unless it was drawn a moment ago."""
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
            """Draw the progress of a stage in its own bar."""
            raise_received()
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=None, left="")
            elif done == 0:
                bars.reset(tasks[stage])
            until_end = remaining.text(stage, done, total, time.monotonic())
            bars.update(tasks[stage], completed=done, total=total or None, left=until_end)

        yield show
