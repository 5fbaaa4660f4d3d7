"""Studies: one scenario flown over and over, some of its values varied, with several seeds each.

Every setting of the varied keys is a case, and every case is flown with the seeds s, s + 1, ... The
statistics of a case are means over its trials, and their spread is the standard deviation from trial to trial. A case
that cannot be flown, or that fails in flight, keeps its place with the reason; an interrupt keeps what is done.
"""

import logging
from collections import Counter
from dataclasses import asdict

from sionna_radar.foundation.errors import BackendError
from sionna_radar.foundation.interrupts import Interrupted, raise_received
from sionna_radar.foundation.kept_parts import KeptParts
from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.scenario import Scenario
from sionna_radar.studies.sweep_plan import Shard, SweepPlan, failure
from sionna_radar.studies.sweep_result import Case, Sweep, Trial
from sionna_radar.survey.chain import run
from sionna_radar.survey.recording import BLOCK_SIZE

logger = logging.getLogger("sionna_radar")


def fly_sweep(
    plan: SweepPlan,
    *,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    parts: KeptParts | None = None,
    shard: Shard | None = None,
) -> Sweep:
    """Fly all trials of a study one after another, or those of a shard of it.

    A trial that fails ends its case, which says why. An interrupt ends the study, which keeps the trials done: those
    of `parts` in their folder, from where it goes on.

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

    Raises
    ------
    BackendError
        The ray tracer cannot run here.

    Examples
    --------
    >>> short = {"platform.length_m": 10.0, "terrain.spacing_m": 2.0}
    >>> plan = plan_sweep("hills", {"radar.snr_db": [20.0, 40.0]}, overrides=short)
    >>> fly_sweep(plan).failed
    False

    """
    trials: list[list[Trial]] = [[] for _ in plan.cells]
    reasons = [cell.refusal for cell in plan.cells]
    interrupted = False
    flights = [flight for number, flight in enumerate(plan.flights()) if shard is None or shard.holds(number)]
    wanted = Counter(number for number, _, _ in flights)
    try:
        for number, scenario, repeat in flights:
            if reasons[number]:
                continue
            progress("surveys", sum(map(len, trials)), len(flights))
            try:
                trials[number].append(_flown(scenario, repeat, block_size, progress, parts))
            except BackendError:
                raise
            except Exception as error:
                # Hours of other trials must not be lost by one, whatever it fails of.
                raise_received()
                logger.debug("a trial failed", exc_info=True)
                reasons[number] = failure(error, scenario, repeat)
        progress("surveys", sum(map(len, trials)), len(flights))
    except (KeyboardInterrupt, Interrupted):
        if parts is not None:
            raise
        interrupted = True
    cases = [
        Case(
            setting=cell.setting,
            scenario=cell.scenario,
            trials=tuple(flown),
            reason=reason or ("" if len(flown) == wanted[number] else "interrupted"),
        )
        for number, (cell, flown, reason) in enumerate(zip(plan.cells, trials, reasons, strict=True))
    ]
    return Sweep(
        source=plan.source,
        axes=plan.axes,
        repeat=plan.repeat,
        cases=tuple(cases),
        interrupted=interrupted,
        shard=str(shard or ""),
    )


def _flown(scenario: Scenario, repeat: int, block_size: int, progress: Progress, parts: KeptParts | None) -> Trial:
    """Return a trial that was flown before, or fly it and keep it."""
    scenario = scenario.model_copy(update={"seed": scenario.seed + repeat})
    key = scenario.model_dump_json()
    kept = parts.get_document(key) if parts is not None else None
    if kept is not None:
        return Trial.of_document(kept)
    trial = _fly(scenario, block_size, progress)
    if parts is not None:
        parts.put_document(key, asdict(trial))
    return trial


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
