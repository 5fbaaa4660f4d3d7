"""Studies of one scenario, with varied values and several seeds each.

Every setting of the varied keys is a case, and every case is flown with the seeds s, s + 1, ... The
statistics of a case are means over its trials, and their spread is the standard deviation from trial to trial. A case
that cannot be flown, or that fails in flight, keeps its place with the reason; an interrupt keeps finished trials.

The result holds cases with their trials and statistics. Shards of a study, flown by the jobs of an array, are merged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import Failure, Task
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.interrupts import Interrupted
from sionna_radar.foundation.progress import stage
from sionna_radar.scenario import Scenario
from sionna_radar.studies.sweep.common_cells import common_rms_m
from sionna_radar.studies.sweep.plan import Cell, Shard, SweepPlan, failure, plan_sweep
from sionna_radar.studies.sweep.settings import Axis, Design, label
from sionna_radar.studies.sweep.trial import EXPOSURES, PROBABILITIES, Trial, fly_trials, wilson_interval

# Largest number of cases in `repr`.
MAX_LINES = 8


@dataclass(frozen=True, kw_only=True)
class Case:
    """One setting of the varied keys, with its trials; `reason` explains missing ones."""

    setting: dict[str, Any]
    scenario: Scenario | None
    trials: tuple[Trial, ...]
    reason: str = ""

    def of_trials(self, statistic: str) -> Float[np.ndarray, " trial"]:
        """Return one of STATISTICS in every trial; NaN where undefined."""
        return np.array([t.statistic(statistic) for t in self.trials], dtype=float)

    def mean(self, statistic: str) -> float:
        """Return the mean over the trials; NaN if undefined in one, or no trials."""
        return float(np.mean(self.of_trials(statistic))) if self.trials else float("nan")

    def interval(self, statistic: str) -> tuple[float, float]:
        """Return the interval of 95 % of a rate of reported obstacles; NaN for others, and where undefined.

        Of a probability by Wilson, with the trials as draws; of false alarms over all area or time by the Poisson
        distribution.
        """
        values = self.of_trials(statistic)
        if len(values) == 0 or not np.isfinite(values).all():
            return float("nan"), float("nan")
        if statistic in PROBABILITIES:
            return wilson_interval(float(values.mean()), len(values))
        if statistic not in EXPOSURES:
            return float("nan"), float("nan")
        name, unit = EXPOSURES[statistic]
        exposure = np.array([getattr(trial, name) or 0.0 for trial in self.trials]) / unit
        if not exposure.sum() > 0:
            return float("nan"), float("nan")
        alarms = round(float(values @ exposure))
        low = chi2.ppf(0.025, 2 * alarms) / 2 if alarms else 0.0
        return float(low / exposure.sum()), float(chi2.ppf(0.975, 2 * alarms + 2) / 2 / exposure.sum())

    def spread(self, statistic: str) -> float:
        """Return the standard deviation from trial to trial; NaN for a single trial."""
        return float(np.std(self.of_trials(statistic), ddof=1)) if len(self.trials) > 1 else float("nan")


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Results of a study or shard, whole or up to an interrupt.

    source, axes, repeat: the scenario, its varied keys, and number of seeds.
    cases: one for each setting.
    interrupted: True if an interrupt ended it.
    shard: part of the study, as I/N; "" for the whole.

    Examples
    --------
    >>> short = {"platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    >>> plan = plan_sweep("hills", {"radar.snr_db": [20.0, 40.0]}, overrides=short)
    >>> sweep = run_sweep(plan)
    >>> [case.setting for case in sweep.cases]
    [{'radar.snr_db': 20.0}, {'radar.snr_db': 40.0}]
    """

    source: str
    axes: tuple[Axis, ...]
    repeat: int
    cases: tuple[Case, ...]
    interrupted: bool = False
    shard: str = ""

    @property
    def failed(self) -> bool:
        """True if any case lacks a trial."""
        return any(case.reason for case in self.cases)

    def __repr__(self) -> str:
        head = f"Sweep of {self.source}: {len(self.cases)} cases x {self.repeat} seeds, RMS error of lit cells"
        results = [(c, c.reason or f"{c.mean('rms_m'):.3f} m") for c in self.cases[:MAX_LINES]]
        rows = [f"  {label(c.setting)}: {result}" for c, result in results]
        hidden = len(self.cases) - len(rows)
        return "\n".join([head, *rows, *([f"  and {hidden} more"] if hidden else [])])


# A cell of the plan, and the offset of the seed.
Place = tuple[int, int]


def sweep(
    scenario: str | Path,
    varied: Design | Sequence[Axis] | Mapping[str, Sequence[Any]],
    repeat: int = 1,
    overrides: Mapping[str, Any] | None = None,
    *,
    execution: Execution | None = None,
) -> Sweep:
    """Fly a scenario with varied values; `plan_sweep` and `run_sweep` in one call.

    Parameters
    ----------
    scenario, varied, repeat, overrides:
        As for `plan_sweep`, whose `source` is the scenario.
    execution:
        As for `sionna_radar.run`; the surveys are a stage, beside those of each.

    Returns
    -------
    The results of each setting with each seed; errors in metres.

    Raises
    ------
    ScenarioError, InputFileError
        No setting can be flown; all problems of all settings are listed.

    Examples
    --------
    >>> short = {"platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    >>> [len(case.trials) for case in sweep("hills", {"radar.snr_db": [20.0, 40.0]}, overrides=short).cases]
    [1, 1]
    """
    return run_sweep(plan_sweep(scenario, varied, repeat, overrides), execution=execution)


def run_sweep(
    plan: SweepPlan, *, shard: Shard | None = None, keep_maps: bool = False, execution: Execution | None = None
) -> Sweep:
    """Fly all trials of a study, or of one shard: sequentially, or on workers.

    A case with a failed trial holds the reason. An interrupt ends the study, which keeps finished trials; with
    checkpoints it resumes from them.

    Parameters
    ----------
    plan:
        The study, from `plan_sweep`.
    shard:
        Subset of the trials to fly; see `Shard`. None for all.
    keep_maps:
        Hold the maps of all trials in memory. Without it only errors are held, until they are compared over the cells
        that all trials fill (of a shard until they are written, as `merge_shards` compares them).
    execution:
        As for `sionna_radar.run`; the surveys are a stage, beside those of each.

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
    >>> run_sweep(plan).failed
    False
    """
    flights = [flight for number, flight in enumerate(plan.flights()) if shard is None or shard.holds(number)]
    execution = execution or Execution()
    places, tasks = _tasks(flights, execution.block_size, keep_maps)
    flown: dict[Place, Trial | Failure] = {}
    interrupted = False
    steps = {key: len(surveys) for key, surveys in places.items()}
    try:
        with execution.reported(), stage("surveys", len(flights)):
            for key, result in fly_trials(execution, tasks, steps):
                flown |= dict.fromkeys(places[key], result)
    except (KeyboardInterrupt, Interrupted):
        if execution.checkpoints is not None:
            raise
        interrupted = True
    repeats: dict[int, list[int]] = {}
    for number, _, repeat in flights:
        repeats.setdefault(number, []).append(repeat)
    if shard is None:  # otherwise `merge_shards` compares the maps of all shards
        flown = _over_common_cells(flown, keep_maps=keep_maps)
    return Sweep(
        source=plan.source,
        axes=plan.axes,
        repeat=plan.repeat,
        cases=tuple(_case(cell, number, repeats.get(number, ()), flown) for number, cell in enumerate(plan.cells)),
        interrupted=interrupted,
        shard=str(shard or ""),
    )


def _tasks(
    flights: Sequence[tuple[int, Scenario, int]], block_size: int, keep_maps: bool
) -> tuple[dict[str, list[Place]], dict[str, Task]]:
    """Return the cells and seeds of each distinct survey, and the surveys as tasks, both by key."""
    places: dict[str, list[Place]] = {}
    tasks: dict[str, Task] = {}
    for number, scenario, repeat in flights:
        document = scenario.model_copy(update={"seed": scenario.seed + repeat}).model_dump_json()
        key = f"{document} with maps" if keep_maps else document
        places.setdefault(key, []).append((number, repeat))
        tasks[key] = {"scenario": document, "block_size": block_size, "keep_maps": keep_maps}
    return places, tasks


def _case(cell: Cell, number: int, repeats: Sequence[int], flown: Mapping[Place, Trial | Failure]) -> Case:
    trials, reason = [], cell.refusal
    for repeat in repeats:
        outcome = flown.get((number, repeat))
        if isinstance(outcome, Trial):
            trials.append(outcome)
        elif not reason and cell.scenario is not None:
            reason = "interrupted" if outcome is None else failure(outcome, cell.scenario, repeat)
    return Case(setting=cell.setting, scenario=cell.scenario, trials=tuple(trials), reason=reason)


def _over_common_cells(flown: Mapping[Place, Trial | Failure], *, keep_maps: bool) -> dict[Place, Trial | Failure]:
    """Return the trials with their errors over the cells that all of them lit and filled, if their cells coincide."""
    trials = {place: trial for place, trial in flown.items() if isinstance(trial, Trial) and trial.maps}
    common = common_rms_m([trial.maps["error"] for trial in trials.values()])
    rms_m: Sequence[float | None] = common or [None] * len(trials)
    compared = {
        place: replace(trial, common_rms_m=rms, maps=trial.maps if keep_maps else {})
        for (place, trial), rms in zip(trials.items(), rms_m, strict=True)
    }
    return {**flown, **compared}


def merge_shards(shards: Sequence[Sweep]) -> Sweep:
    """Return the whole study from its shards, identical to one flown at once.

    Raises InputFileError for shards of different studies, a missing or duplicate one, and for a whole study.
    """
    parsed = [Shard.parse(sweep.shard) for sweep in shards if sweep.shard]
    if len(parsed) < len(shards):
        raise InputFileError("one of the folders holds a whole study, not a shard; leave it out")
    studies = [(s.source, s.axes, s.repeat, [case.scenario for case in s.cases]) for s in shards]
    for study, shard in zip(studies[1:], parsed[1:], strict=True):
        if study != studies[0]:
            raise InputFileError(f"shards {parsed[0]} and {shard} are of different studies; merge those of one")
        if shard.count != parsed[0].count:
            raise InputFileError(f"shards {parsed[0]} and {shard} are of different counts; merge those of one study")
    numbers = [shard.number for shard in parsed]
    twice = sorted({number for number in numbers if numbers.count(number) > 1})
    missing = sorted(set(range(1, parsed[0].count + 1)) - set(numbers))
    if twice:
        raise InputFileError(f"shard {twice[0]}/{parsed[0].count} is there twice; name its folder once")
    if missing:
        listed = ", ".join(f"{number}/{parsed[0].count}" for number in missing)
        raise InputFileError(f"shard {listed} is missing; name its folder, too")
    cases = [_merged(same) for same in zip(*(sweep.cases for sweep in shards), strict=True)]
    flown: dict[Place, Trial | Failure] = {
        (number, repeat): trial for number, case in enumerate(cases) for repeat, trial in enumerate(case.trials)
    }
    flown = _over_common_cells(flown, keep_maps=False)
    compared = [
        replace(case, trials=tuple(t for place, t in flown.items() if place[0] == number and isinstance(t, Trial)))
        for number, case in enumerate(cases)
    ]
    return replace(shards[0], cases=tuple(compared), shard="")


def _merged(cases: Sequence[Case]) -> Case:
    trials = sorted((trial for case in cases for trial in case.trials), key=lambda trial: trial.seed)
    return replace(cases[0], trials=tuple(trials), reason=next((case.reason for case in cases if case.reason), ""))
