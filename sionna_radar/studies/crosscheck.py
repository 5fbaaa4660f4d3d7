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

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.mapping.methods.linear import Linear
from sionna_radar.mapping.points import Points, locate
from sionna_radar.scenario import Scenario
from sionna_radar.studies.crosscheck_result import CrossCheck, EngineResult, Tolerances
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.recording import BLOCK_SIZE, fly
from sionna_radar.survey.sensors.radar import Radar
from sionna_radar.tracing.engine import Engine, EngineInputs, build_engine
from sionna_radar.tracing.paths import Paths


def crosscheck(
    scenario: Scenario,
    *,
    tolerances: Tolerances | None = None,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
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
    total = 4 * len(prepared)
    results: dict[str, EngineResult] = {}
    for name, repeat in (("sionna", 0), ("sionna_again", 1), ("gamma", 0), ("gamma_again", 1)):
        seed = scenario.seed + repeat if scenario.seed + repeat < 2**63 else 0
        engine = "gamma" if name.startswith("gamma") else "sionna"
        offset = len(results) * len(prepared)
        results[name] = _fly(prepared, engine, seed, block_size, partial(_report, progress, offset, total))
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


def _report(progress: Progress, offset: int, total: int, done: int) -> None:
    progress("tracing", offset + done, total)


def _fly(prepared: Prepared, engine: str, seed: int, block_size: int, progress: Callable[[int], None]) -> EngineResult:
    """Fly all pulses with an engine; noise, weather and targets are those of the scenario's seed."""
    drawn_anew = {"engine": engine, "speckle": "per_pulse", "decorrelation_time_s": None}
    table = prepared.local.tracing.model_copy(update=drawn_anew)

    def build(given: EngineInputs) -> Engine:
        return build_engine(table, replace(given, tracing=table, seed=seed))

    count = len(prepared)
    power, range_m, incidence, echo_range_m = (np.full(count, np.nan) for _ in range(4))
    located = []
    # Of a pair of sweeps the engines are compared on the first alone.
    receiver = replace(prepared.receiver, sweeps=prepared.receiver.sweeps[:1])
    radar = Radar(replace(prepared.sensor_inputs(), custom_engine=build, receiver=receiver))
    for block in fly(prepared.flight.line_blocks(block_size), radar):
        pulses, here = block.pulses, block.pulses.index
        echoes = radar.correct(block.observation.echoes, here, pulses.measured)
        power[here], range_m[here], incidence[here] = _means(block.observation.paths, int(here[0]), len(here))
        order = np.argsort(echoes.power, kind="stable")
        echo_range_m[echoes.pulse[order]] = echoes.range_m[order]
        located.append(locate(echoes, here, pulses.measured))
        progress(int(here[-1]) + 1)
    return EngineResult(
        seed=seed,
        power=power,
        range_m=range_m,
        incidence_rad=incidence,
        echo_range_m=echo_range_m,
        dem=Linear()(prepared.mapper.inputs(Points.concatenate(located))).dem,
    )


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
