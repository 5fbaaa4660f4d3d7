"""A survey flown by workers: each prepares the scenario once, and flies the stretches that it is given."""

from collections.abc import Sequence
from functools import lru_cache

from sionna_radar.accuracy.truth import Tally
from sionna_radar.foundation.checkpoints import Checkpoints
from sionna_radar.foundation.errors import PluginError
from sionna_radar.foundation.progress import Progress, Stopwatch, silent
from sionna_radar.foundation.threads import beside
from sionna_radar.foundation.workers import Failure, Task, Workers, each_kept
from sionna_radar.scenario import Scenario
from sionna_radar.survey.preparation import CustomParts, Prepared, prepare
from sionna_radar.survey.recording import (
    BLOCK_SIZE,
    FinishedStretch,
    Recorder,
    Recording,
    fly_stretch,
    joined,
    key_of,
    record,
    stretches_of,
)
from sionna_radar.survey.sensors.sensor import Sensor


def record_with(
    workers: Workers | None,
    prepared: Prepared,
    *,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    watch: Stopwatch | None = None,
    recorders: Sequence[Recorder] = (),
    parts: Checkpoints | None = None,
) -> tuple[Sensor, Recording]:
    """Return a sensor and what it observed, flown by workers if there are any; with recorders by this process.

    See `record` for the rest. While workers begin, this process builds the sensor, for what follows the flight.

    Raises
    ------
    PluginError
        Parts of the scenario were replaced from Python, which workers do not have.
    RadarError
        A stretch cannot be flown.

    """
    watch = watch or Stopwatch()
    progress("tracing", 0, 0)
    if workers is not None and workers.count and not recorders:
        refuse_custom(prepared.custom)
        sensor = beside(prepared.build_sensor)
        with watch("workers"):
            recording = record_on_workers(prepared, workers, block_size=block_size, progress=progress, parts=parts)
        return sensor(), recording
    with watch("prepare"):
        own = prepared.build_sensor(watch)
    return own, record(
        prepared,
        own,
        block_size=block_size,
        progress=progress,
        watch=watch,
        recorders=recorders,
        parts=None if recorders else parts,
    )


def record_on_workers(
    prepared: Prepared,
    workers: Workers,
    *,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    parts: Checkpoints | None = None,
) -> Recording:
    """Have workers fly a prepared survey, and return what `record` does, bit for bit.

    Finished stretches are kept in `parts` as they come, and those that are there already are not flown again.

    Raises
    ------
    RadarError
        A stretch cannot be flown.

    """
    stretches = stretches_of(prepared, block_size)
    scenario = prepared.scenario.model_dump_json()
    tasks = {key_of(stretch): {"scenario": scenario, "blocks": stretch} for stretch in stretches}
    pulses = {key_of(stretch): stretch[-1][1] - stretch[0][0] for stretch in stretches}
    finished: dict[str, bytes] = {}
    progress("tracing", 0, len(prepared))
    for key, found in each_kept(workers, fly_task, tasks, parts):
        if isinstance(found, Failure):
            raise found.error()
        finished[key] = found
        progress("tracing", sum(pulses[key] for key in finished), len(prepared))
    tally = Tally(prepared.truth(), prepared.receiver.chirp)
    seen = []
    for stretch in stretches:
        one = FinishedStretch.unpacked(finished.pop(key_of(stretch)))
        seen.append(one.seen)
        tally.add_counted(one.counted)
    return joined(seen, tally)


def refuse_custom(custom: CustomParts) -> None:
    """Raise PluginError for parts given in Python: workers have what a scenario names, and packages registered."""
    replaced = custom.described()
    if replaced:
        message = (
            f"{', '.join(replaced)} replaced from Python: workers do not have it; fly without them, or register it in "
            "a package with the entry point sionna_radar.plugins that they have, too"
        )
        raise PluginError(message)


def fly_task(task: Task, progress: Progress) -> bytes:
    """Fly the stretch of a task, and return the bytes of what was found."""
    prepared, sensor = ready(task["scenario"])
    return fly_stretch(prepared, sensor, [(first, end) for first, end in task["blocks"]]).packed()


@lru_cache(maxsize=1)
def ready(scenario: str) -> tuple[Prepared, Sensor]:
    """Return a prepared survey and its sensor: a worker flies many stretches of one."""
    prepared = prepare(Scenario.model_validate_json(scenario))
    return prepared, prepared.build_sensor()
