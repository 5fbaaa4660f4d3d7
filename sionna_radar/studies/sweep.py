"""Studies: one scenario flown over and over, some of its values varied, with several seeds each.

Every setting of the varied keys is a case, and every case is flown with the seeds s, s + 1, ... The
statistics of a case are means over its trials, and their spread is the standard deviation from trial to trial. A case
that cannot be flown, or that fails in flight, keeps its place with the reason; an interrupt keeps what is done.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict

from sionna_radar.foundation.errors import BackendError
from sionna_radar.foundation.interrupts import Interrupted
from sionna_radar.foundation.kept_parts import KeptParts
from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.foundation.workers import Failure, InProcess, Task, Workers, document_bytes, document_of, each_kept
from sionna_radar.scenario import Scenario
from sionna_radar.studies.sweep_plan import Cell, Shard, SweepPlan, failure
from sionna_radar.studies.sweep_result import Case, Sweep, Trial
from sionna_radar.survey.chain import run
from sionna_radar.survey.recording import BLOCK_SIZE

# A cell of the plan, and how far the seed is raised.
Place = tuple[int, int]


def fly_sweep(
    plan: SweepPlan,
    *,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    parts: KeptParts | None = None,
    shard: Shard | None = None,
    workers: Workers | None = None,
) -> Sweep:
    """Fly all trials of a study, or those of a shard of it: one after another, or on workers.

    A case of which a trial fails says why. An interrupt ends the study, which keeps the trials done: those of `parts`
    in their folder, from where it goes on.

    Parameters
    ----------
    plan:
        The study, from `plan_sweep`.
    block_size:
        Pulses simulated at once; it never changes the result.
    progress:
        Called at the start of each stage and after each of its steps: those of each survey, and the surveys.
    parts:
        Where finished trials are kept, and those that are there already are taken from.
    shard:
        Which of them are flown; see `Shard`. Without it all.
    workers:
        What flies them, from `open_workers`; without it this process. It never changes the result.

    Raises
    ------
    BackendError
        The ray tracer cannot run here.
    WorkerError
        The workers are gone, or have another version of the program.

    Examples
    --------
    >>> short = {"platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    >>> plan = plan_sweep("hills", {"radar.snr_db": [20.0, 40.0]}, overrides=short)
    >>> fly_sweep(plan).failed
    False

    """
    flights = [flight for number, flight in enumerate(plan.flights()) if shard is None or shard.holds(number)]
    places, tasks = _tasks(flights, block_size)
    flown: dict[Place, Trial | Failure] = {}
    interrupted = False
    progress("surveys", 0, len(flights))
    try:
        for key, found in each_kept(workers or InProcess(), fly_trial, tasks, parts, progress):
            if isinstance(found, Failure) and found.kind == BackendError.__name__:
                raise found.error()
            result = found if isinstance(found, Failure) else Trial.of_document(document_of(found))
            flown |= dict.fromkeys(places[key], result)
            progress("surveys", len(flown), len(flights))
    except (KeyboardInterrupt, Interrupted):
        if parts is not None:
            raise
        interrupted = True
    wanted: dict[int, list[int]] = {}
    for number, _, repeat in flights:
        wanted.setdefault(number, []).append(repeat)
    return Sweep(
        source=plan.source,
        axes=plan.axes,
        repeat=plan.repeat,
        cases=tuple(_case(cell, number, wanted.get(number, ()), flown) for number, cell in enumerate(plan.cells)),
        interrupted=interrupted,
        shard=str(shard or ""),
    )


def _tasks(
    flights: Sequence[tuple[int, Scenario, int]], block_size: int
) -> tuple[dict[str, list[Place]], dict[str, Task]]:
    """Return the surveys as tasks by their keys, and the cells and seeds that each belongs to."""
    places: dict[str, list[Place]] = {}
    for number, scenario, repeat in flights:
        key = scenario.model_copy(update={"seed": scenario.seed + repeat}).model_dump_json()
        places.setdefault(key, []).append((number, repeat))
    return places, {key: {"scenario": key, "block_size": block_size} for key in places}


def _case(cell: Cell, number: int, repeats: Sequence[int], flown: Mapping[Place, Trial | Failure]) -> Case:
    """Return a setting with the trials that were flown of it, and why others were not."""
    trials, reason = [], cell.refusal
    for repeat in repeats:
        found = flown.get((number, repeat))
        if isinstance(found, Trial):
            trials.append(found)
        elif not reason and cell.scenario is not None:
            reason = "interrupted" if found is None else failure(found, cell.scenario, repeat)
    return Case(setting=cell.setting, scenario=cell.scenario, trials=tuple(trials), reason=reason)


def fly_trial(task: Task, progress: Progress) -> bytes:
    """Fly the survey of a task, and return its trial as a JSON document."""
    scenario = Scenario.model_validate_json(task["scenario"])
    return document_bytes(asdict(_fly(scenario, task["block_size"], progress)))


def _fly(scenario: Scenario, block_size: int, progress: Progress) -> Trial:
    survey = run(scenario, block_size=block_size, progress=progress)
    return Trial(
        seed=scenario.seed,
        echoes=len(survey.points),
        points_sha256=survey.points.sha256(),
        dem_error=survey.dem_error,
        lit_error=survey.lit_error,
        off_wall_error=survey.off_wall_error,
        warnings=survey.warnings,
        wall_s=survey.timing_s["total"],
        peak_memory_mb=survey.peak_memory_mb,
    )
