"""Tasks of the tests, which workers import by the name of this module."""

import json
import logging
import os
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from sionna_radar.execution.workers import SHARED, Failure, Task, Work, attempt
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.input_file import network_allowed
from sionna_radar.foundation.threads import cores


class LikeWorkers:
    """Does tasks as workers would, the last first: functions by their names, tasks as JSON."""

    count = 2

    def __init__(self) -> None:
        self.tasks: list[Task] = []

    def each(self, work: Work, tasks: Sequence[Task], shared: Any = None) -> Iterator[tuple[int, bytes | Failure]]:
        for number, task in reversed(list(enumerate(tasks))):
            self.tasks.append(task)
            yield (
                number,
                attempt(
                    resolve_name(f"{work.__module__}:{work.__qualname__}"),
                    {**json.loads(json.dumps(task)), SHARED: shared},
                ),
            )


def look(task: Mapping[str, Any]) -> bytes:
    """Do as the task says, and return what this process is."""
    if task["do"] == "refuse":
        raise ScenarioError([Problem("some.key", "1 is refused; give 2")])
    if task["do"] == "fail":
        raise KeyError(task["do"])
    if task["do"] == "die":
        with Path(task["deaths"]).open("a") as file:
            file.write(f"{os.getpid()}\n")
        os.kill(os.getpid(), signal.SIGKILL)
    if task["do"] == "sleep":
        time.sleep(60)
    if task["do"] == "warn":
        logging.getLogger("sionna_radar").warning("mind %s", "this")
    here = {"pid": os.getpid(), "cores": cores(), "network": network_allowed()}
    return json.dumps(here | {"x": task["x"]}).encode()
