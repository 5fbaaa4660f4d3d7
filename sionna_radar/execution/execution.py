"""How a survey or study is computed: block size, workers, checkpoints and progress."""

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from sionna_radar.execution.checkpoints import Checkpoints
from sionna_radar.execution.workers import SHARED, Failure, InProcess, Task, Work, Workers, attempt
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.progress import Progress, advance, steps_done
from sionna_radar.foundation.progress_bars import shown_progress
from sionna_radar.foundation.threads import several_at_once

BLOCK_SIZE = 512


@dataclass(frozen=True, kw_only=True)
class Execution:
    """Settings of a computation that affect time and memory, never the result.

    block_size: pulses simulated at once.
    workers: processes that share the work, from `open_workers`; None: this process.
    checkpoints: where results of finished tasks are saved, and from which existing ones are read; see
    `open_checkpoints`.
    progress: called at the start of each stage and after each of its steps with its name, the steps done and their
        number, 0 if unknown; None for a bar in a notebook and nothing in a script.

    Raises
    ------
    ScenarioError
        The block size is less than 1.

    Examples
    --------
    >>> run(load_scenario("hills", {"platform.length_m": 10.0}), execution=Execution(block_size=32)).pulses
    100
    """

    block_size: int = BLOCK_SIZE
    workers: Workers | None = None
    checkpoints: Checkpoints | None = None
    progress: Progress | None = None

    def __post_init__(self) -> None:
        if self.block_size < 1:
            message = f"{self.block_size} pulses a block are too few; give at least 1"
            raise ScenarioError([Problem("block_size", message)])

    @property
    def distributed(self) -> bool:
        """Whether worker processes do the work."""
        return self.workers is not None and self.workers.count > 0

    def reported(self) -> AbstractContextManager[None]:
        """Return a context that reports progress."""
        return shown_progress(self.progress)

    def missing(self, tasks: Mapping[str, Task]) -> list[str]:
        """Return the keys of tasks without a checkpoint."""
        return [key for key in tasks if self.checkpoints is None or key not in self.checkpoints]

    def over(
        self,
        tasks: Mapping[str, Task],
        work: Work,
        *,
        shared: Any = None,
        steps: Mapping[str, int] | None = None,
        side_by_side: bool = False,
    ) -> Iterator[tuple[str, bytes | Failure]]:
        """Yield key and result of each task: checkpoints first, then others as they finish.

        Each result is saved at once; failures are not, so a resumed run retries them.

        Parameters
        ----------
        tasks:
            JSON documents by checkpoint key.
        work:
            Returns the result of a task as bytes. For workers it must be a module-level function.
        shared:
            Payload common to all tasks, passed in their entry `SHARED`; bytes if sent to workers.
        steps:
            Progress steps of each task; default one.
        side_by_side:
            Whether this process runs several tasks at once, in threads.
        """
        keys = []
        for key in tasks:
            content = None if self.checkpoints is None else self.checkpoints.get(key)
            if content is None:
                keys.append(key)
                continue
            advance(1 if steps is None else steps[key])
            yield key, content
        counts = [1 if steps is None else steps[key] for key in keys]
        todo = [{**tasks[key], SHARED: shared} for key in keys]
        if side_by_side and not self.distributed:
            several = several_at_once(lambda number: attempt(work, todo[number]), range(len(keys)), counts)
            done: Iterator[tuple[int, bytes | Failure]] = enumerate(several)
        else:
            done = (self.workers or InProcess()).each(work, [tasks[key] for key in keys], shared)
        for _ in keys:
            before = steps_done()
            number, result = next(done)
            if self.checkpoints is not None and not isinstance(result, Failure):
                self.checkpoints.put(keys[number], result)
            advance(counts[number] - (steps_done() - before))
            yield keys[number], result

    def done(self, tasks: Mapping[str, Task], work: Work, **options: Any) -> Iterator[tuple[str, bytes]]:
        """Yield key and result of each task as `over` does; raise the error of a failed one."""
        for key, result in self.over(tasks, work, **options):
            if isinstance(result, Failure):
                raise result.error()
            yield key, result
