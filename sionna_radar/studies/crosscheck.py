"""Two engines compared over one survey: the electromagnetic one and the paper's facets.

Both trace the same pulses over the same meshes. The power of a pulse's echo is compared as the sum of
|gain|^2 over its paths, that is before they interfere, so it is free of speckle and the engines must agree
closely. The DEMs are made of speckled echoes, and each engine draws its own speckle: two seeds of ONE engine
already differ. So each engine flies with two seeds, all four cross pairs are compared with the two pairs of one
engine, and `speckle_test` gives the probability that speckle alone makes such a difference. The noise of the
receiver, the rain and the fluctuation of targets are the same in all four.

What the two share is not checked by this: Mitsuba's ray casting (shadows), the antenna's pattern, the models of
backscatter, point targets, and mirror reflections, which are traced apart from both engines and added to each. Where
a mirror outshines the diffuse echo the engines agree because it is one and the same.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.kept_parts import KeptParts
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.packing import columns_of, packed, table_of
from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.foundation.workers import SHARED, Failure, InProcess, Task, Workers, each_kept
from sionna_radar.mapping.methods.linear import Linear
from sionna_radar.mapping.points import Points, locate
from sionna_radar.scenario import Scenario
from sionna_radar.studies.crosscheck_result import CrossCheck, EngineResult, Tolerances
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.recording import BLOCK_SIZE, fly, key_of, stretches_of
from sionna_radar.survey.sensors.radar import Radar
from sionna_radar.survey.shared_flight import ready
from sionna_radar.tracing.engine import Engine, EngineInputs, build_engine
from sionna_radar.tracing.paths import Paths

_last_radar: list[tuple[Prepared, str, int, Radar]] = []


def crosscheck(
    scenario: Scenario,
    *,
    tolerances: Tolerances | None = None,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    parts: KeptParts | None = None,
    workers: Workers | None = None,
) -> CrossCheck:
    """Fly a survey with both engines, each with two seeds, and compare what they find.

    Parameters
    ----------
    scenario:
        The survey; its own choice of engine does not matter.
    tolerances:
        How far the engines may lie apart.
    block_size:
        Pulses simulated at once; it changes the speed and the memory, never the result.
    progress:
        Called at the start of each stage and after each of its steps; the four runs are one stage.
    parts:
        Where finished stretches of the runs are kept, and those that are there already are taken from.
    workers:
        What flies them, from `open_workers`; without it this process. It never changes the result.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown, or has nothing but point targets to see.

    Examples
    --------
    >>> check = crosscheck(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> abs(check.mean_power_difference_db) < 0.1
    True

    """
    if scenario.sensor != "radar":
        message = f"{scenario.sensor!r} uses no tracing engine; set sensor = 'radar' to compare the engines"
        raise ScenarioError([Problem("sensor", message)])
    prepared = prepare(scenario, progress=progress)
    results = _fly_all(prepared, block_size, progress, parts, workers or InProcess())
    if not (results["sionna"].power > 0).any():
        message = "no pulse of the survey meets a surface; there is nothing to compare"
        raise ScenarioError([Problem("terrain", message)])
    return CrossCheck(
        scenario=scenario, tolerances=tolerances or Tolerances(), correlation_m=_correlation_m(prepared), **results
    )


def _correlation_m(prepared: Prepared) -> float:
    """Return how far apart errors of the DEM still belong together: a footprint, or the gap that is filled."""
    pose = prepared.flight.sample(1000).true
    clearance = float(np.median(pose.position_m[:, 2] - prepared.scene.ground_m(pose.position_m[:, :2])))
    incidence_rad = prepared.flight.scan.incidence_rad
    footprint = clearance * max(prepared.antenna.beamwidths_rad) / np.cos(incidence_rad) ** 2
    return max(float(footprint), prepared.mapper.max_gap_m / 2)


def _fly_all(
    prepared: Prepared, block_size: int, progress: Progress, parts: KeptParts | None, workers: Workers
) -> dict[str, EngineResult]:
    """Return what each engine made of the survey with each of its two seeds."""
    first = prepared.scenario.seed
    scenario, stretches = prepared.scenario.model_dump_json(), stretches_of(prepared, block_size)
    runs, tasks, pulses = {}, {}, {}
    for name, repeat in (("sionna", 0), ("sionna_again", 1), ("gamma", 0), ("gamma_again", 1)):
        seed = first + repeat if first + repeat < 2**63 else 0
        runs[name] = seed
        for stretch in stretches:
            key = f"{name} {key_of(stretch)}"
            engine = "gamma" if name.startswith("gamma") else "sionna"
            tasks[key] = {"scenario": scenario, "engine": engine, "seed": seed, "blocks": stretch}
            pulses[key] = stretch[-1][1] - stretch[0][0]
    found: dict[str, bytes] = {}
    done = 0
    progress("tracing", 0, 4 * len(prepared))
    for key, result in each_kept(workers, fly_task, tasks, parts, shared=None if workers.count else prepared):
        if isinstance(result, Failure):
            raise result.error()
        found[key] = result
        done += pulses[key]
        progress("tracing", done, 4 * len(prepared))
    return {
        name: _joined(prepared, seed, [columns_of(found[f"{name} {key_of(stretch)}"]) for stretch in stretches])
        for name, seed in runs.items()
    }


def _joined(prepared: Prepared, seed: int, stretches: Sequence[Mapping[str, Any]]) -> EngineResult:
    """Return what an engine made of a survey from what it made of its stretches."""
    names = ("power", "range_m", "incidence_rad", "echo_range_m")
    points = Points.concatenate([table_of(Points, "points", dict(columns)) for columns in stretches])
    return EngineResult(
        seed=seed,
        **{name: np.concatenate([columns[name] for columns in stretches]) for name in names},
        dem=Linear()(prepared.mapper.inputs(points)).dem,
    )


def fly_task(task: Task, progress: Progress) -> bytes:
    """Fly the stretch of a task with its engine, and return the bytes of what it found."""
    prepared = task[SHARED] or ready(task["scenario"])[0]
    return _fly(prepared, task["engine"], task["seed"], [(first, end) for first, end in task["blocks"]])


@on_one_thread
def _fly(prepared: Prepared, engine: str, seed: int, stretch: Sequence[tuple[int, int]]) -> bytes:
    """Fly some blocks with an engine; noise, weather and targets are those of the scenario's seed."""
    radar, offset, count = _radar(prepared, engine, seed), stretch[0][0], stretch[-1][1] - stretch[0][0]
    power, range_m, incidence, echo_range_m = (np.full(count, np.nan) for _ in range(4))
    located = []
    for block in fly((prepared.flight.pulses(np.arange(*bounds)) for bounds in stretch), radar):
        pulses, here = block.pulses, block.pulses.index
        echoes = radar.correct(block.observation.echoes, here, pulses.measured)
        at = here - offset
        power[at], range_m[at], incidence[at] = _means(block.observation.paths, int(here[0]), len(here))
        order = np.argsort(echoes.power, kind="stable")
        echo_range_m[echoes.pulse[order] - offset] = echoes.range_m[order]
        located.append(locate(echoes, here, pulses.measured))
    return packed(
        power=power,
        range_m=range_m,
        incidence_rad=incidence,
        echo_range_m=echo_range_m,
        points=Points.concatenate(located),
    )


def _radar(prepared: Prepared, engine: str, seed: int) -> Radar:
    """Return a radar with an engine: the last one again, as the stretches of a run come one after another."""
    for known, *its, radar in _last_radar:
        if known is prepared and its == [engine, seed]:
            return radar
    drawn_anew = {"engine": engine, "speckle": "per_pulse", "decorrelation_time_s": None}
    table = prepared.local.tracing.model_copy(update=drawn_anew)

    def build(given: EngineInputs) -> Engine:
        return build_engine(table, replace(given, tracing=table, seed=seed))

    # Of a pair of sweeps the engines are compared on the first alone.
    receiver = replace(prepared.receiver, sweeps=prepared.receiver.sweeps[:1])
    radar = Radar(replace(prepared.sensor_inputs(), custom_engine=build, receiver=receiver))
    _last_radar[:] = [(prepared, engine, seed, radar)]
    return radar


def _means(
    paths: Paths, first: int, count: int
) -> tuple[Float[np.ndarray, " pulse"], Float[np.ndarray, " pulse"], Float[np.ndarray, " pulse"]]:
    """Return power, mean range and mean incidence of the surfaces' paths of a block."""
    seen = paths.surface >= 0
    pulse = paths.pulse[seen] - first
    weight = np.abs(paths.gain[seen].astype(np.complex128)) ** 2
    total, by_delay, by_incidence = (
        np.bincount(pulse, weight * column, minlength=count)
        for column in (1.0, paths.delay_s[seen], paths.incidence_rad[seen])
    )
    with np.errstate(invalid="ignore"):
        return total, by_delay / total * (speed_of_light / 2), by_incidence / total
