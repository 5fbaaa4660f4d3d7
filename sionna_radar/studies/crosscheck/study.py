"""Cross-check of the electromagnetic engine and the paper's facets over one survey.

Both trace the same pulses over the same meshes. The power of a pulse's echo is compared as the sum of
|gain|^2 over its paths, that is before interference, so it is free of speckle and the engines must agree
closely. The DEMs are made of speckled echoes, and each engine draws its own speckle: two seeds of ONE engine
already differ. So each engine flies with two seeds, all four cross pairs are compared with the two pairs of one
engine, and `accuracy.randomisation` gives the probability of such a difference from speckle alone. The noise of the
receiver, the rain and the fluctuation of targets are the same in all four.

Shared parts are not checked: Mitsuba's ray casting (shadows), the antenna's pattern, the models of backscatter, point
targets, and mirror reflections, which are traced apart from both engines and added to each. Where a mirror reflection
exceeds the diffuse echo the engines agree trivially.

For the simple model a fit gives the constant gamma that best matches a material over a span of incidence.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.constants import speed_of_light
from scipy.special import ndtri

from sionna_radar.accuracy.randomisation import SpeckleTest, compare_speckle
from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import SHARED, Task
from sionna_radar.foundation.columns import columns_of, packed, table_of
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import stage
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.linear.linear import Linear
from sionna_radar.mapping.points import Points, locate
from sionna_radar.scenario import Scenario
from sionna_radar.survey.observation import key_of, observe_blocks, on_this_worker, segments_of
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.sensors.radar import Radar
from sionna_radar.tracing.build import EngineInputs, build_engine
from sionna_radar.tracing.paths import Engine, Paths

INCIDENCE_STEP_DEG = 5.0


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Tolerances of the differences between the engines.

    mean_power_db: magnitude of the difference of the mean power over all pulses, beyond the scatter of both engines.
    p95_power_db: 95th percentile of the magnitude of the difference of a pulse's power, unless both engines scatter by
        more: a few hundred rays hit an edge of a building, and scatterers of random polarization, as in a circular
        wave, differ in power.
    false_alarm_probability: probability of reporting a difference from scatter and speckle alone.
    dem_factor: RMS difference of the DEMs over that from speckle, up to which even a significant difference is
        negligible.
    """

    mean_power_db: float = 0.1
    p95_power_db: float = 0.5
    false_alarm_probability: float = 1e-3
    dem_factor: float = 1.25


@dataclass(frozen=True, kw_only=True)
class EngineResult:
    """Result of one engine for every pulse, and the DEM.

    power: sum of |gain|^2 over the surfaces' paths; a ratio to the transmitted power.
    range_m, incidence_rad: means over those paths, weighted by power; NaN without any.
    echo_range_m: range of the strongest detected echo, speckle included; NaN without any.
    """

    seed: int
    power: Float[np.ndarray, " pulse"]
    range_m: Float[np.ndarray, " pulse"]
    incidence_rad: Float[np.ndarray, " pulse"]
    echo_range_m: Float[np.ndarray, " pulse"]
    dem: Raster


@dataclass(frozen=True, kw_only=True)
class IncidenceBin:
    """The power difference (gamma over Sionna) of pulses in one class of mean local incidence."""

    incidence_deg: float
    pulses: int
    mean_power_difference_db: float
    std_power_difference_db: float


@dataclass(frozen=True, kw_only=True)
class CrossCheck:
    """Both engines' runs, each with a second seed; differences are gamma minus Sionna.

    tolerances: tolerances of the differences.
    correlation_m: distance over which errors of a DEM are correlated.
    sionna, sionna_again, gamma, gamma_again: results of each engine with either seed.

    Examples
    --------
    >>> check = crosscheck(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> sorted(check.verdict())
    ['dem_rms_difference_m', 'mean_power_difference_db', 'p95_abs_power_difference_db']
    """

    scenario: Scenario
    tolerances: Tolerances
    correlation_m: float
    sionna: EngineResult
    sionna_again: EngineResult
    gamma: EngineResult
    gamma_again: EngineResult

    def __repr__(self) -> str:
        verdict = "agree" if self.agrees else "DIFFER"
        return (
            f"CrossCheck: {self.scenario.description or 'no description'}\n  the engines {verdict} over "
            f"{len(self.sionna.power):,} pulses: mean power {self.mean_power_difference_db:+.3f} dB, DEM "
            f"{self.dem_rms_difference_m:.3f} m RMS apart (speckle alone {self.dem_speckle_rms_m:.3f} m)"
        )

    @property
    def power_difference_db(self) -> Float[np.ndarray, " pulse"]:
        """Difference of each pulse's power, before interference; NaN without power in either engine."""
        return _difference_db(self.gamma, self.sionna)

    @property
    def mean_power_difference_db(self) -> float:
        """Difference of the mean power over all pulses."""
        return _ratio_db(self.gamma.power.sum(), self.sionna.power.sum())

    @property
    def p95_abs_power_difference_db(self) -> float:
        """95th percentile of the magnitude of a pulse's power difference."""
        return _percentile(np.abs(self.power_difference_db), 95.0)

    @property
    def mean_power_scatter_db(self) -> float:
        """Standard deviation of the difference of the mean power: pulses are independent, so their variances add.

        Half the squared difference between two seeds of an engine is the variance of one, pulse by pulse.
        """
        variance = 0.0
        for run, repeat in ((self.sionna, self.sionna_again), (self.gamma, self.gamma_again)):
            mean = (run.power.sum() + repeat.power.sum()) / 2
            variance += float(np.sum((run.power - repeat.power) ** 2) / 2 / mean**2) if mean > 0 else 0.0
        return 10 / math.log(10) * math.sqrt(variance)

    @property
    def p95_power_scatter_db(self) -> float:
        """95th percentile of the magnitude of a pulse's difference by scatter alone.

        The difference between two seeds of one engine has twice its variance, so that the sum over both engines has
        twice the variance of the difference of one run of each. Both percentiles are those of the same number of
        pulses: the order statistic is chosen that falls below the other's with the false-alarm probability.
        """
        seeds_db = _difference_db(self.sionna, self.sionna_again) + _difference_db(self.gamma, self.gamma_again)
        count = int(np.isfinite(seeds_db).sum())
        above = self._sigmas * math.sqrt(2 * 0.95 * 0.05 / max(count, 1))
        return _percentile(np.abs(seeds_db) / math.sqrt(2), min(95.0 + 100 * above, 100.0))

    @property
    def _sigmas(self) -> float:
        """Gaussian quantile of the false-alarm probability, in standard deviations."""
        return float(ndtri(1 - self.tolerances.false_alarm_probability))

    @property
    def dem_difference(self) -> Raster:
        """Gamma's DEM minus Sionna's."""
        return Raster(grid=self.gamma.dem.grid, height_m=self.gamma.dem.height_m - self.sionna.dem.height_m)

    @cached_property
    def dem_test(self) -> SpeckleTest:
        """Test for a difference of the engines' DEMs beyond speckle."""
        return compare_speckle(
            (self.sionna.dem, self.sionna_again.dem), (self.gamma.dem, self.gamma_again.dem), self.correlation_m
        )

    @property
    def dem_rms_difference_m(self) -> float:
        """RMS difference of the engines' DEMs, all pairs of seeds, where all four are filled."""
        return self.dem_test.cross_rms_m

    @property
    def dem_speckle_rms_m(self) -> float:
        """RMS difference of the engines' DEMs expected from independent speckle alone."""
        return self.dem_test.speckle_rms_m

    @property
    def agrees(self) -> bool:
        """True if every difference lies within its tolerance; an undefined one does not."""
        return all(entry["agrees"] for entry in self.verdict().values())

    def verdict(self) -> dict[str, dict[str, Any]]:
        """Return each tested difference with its tolerance."""
        tolerances = self.tolerances
        mean_limit = tolerances.mean_power_db + self._sigmas * self.mean_power_scatter_db
        p95_limit = float(np.fmax(tolerances.p95_power_db, self.p95_power_scatter_db))
        mean, p95 = self.mean_power_difference_db, self.p95_abs_power_difference_db
        test, limit, chance = (
            self.dem_test,
            tolerances.dem_factor * self.dem_speckle_rms_m,
            tolerances.false_alarm_probability,
        )
        probability = test.probability if test.can_reject(chance) else test.gaussian_probability
        return {
            "mean_power_difference_db": {"value": mean, "tolerance": mean_limit, "agrees": abs(mean) <= mean_limit},
            "p95_abs_power_difference_db": {"value": p95, "tolerance": p95_limit, "agrees": abs(p95) <= p95_limit},
            "dem_rms_difference_m": {
                "value": test.cross_rms_m,
                "tolerance": limit,
                "probability": probability,
                "agrees": probability > chance or test.cross_rms_m <= limit,
            },
        }

    def by_incidence(self) -> list[IncidenceBin]:
        """Return the power difference in classes of the mean local incidence."""
        incidence_deg, difference = np.rad2deg(self.sionna.incidence_rad), self.power_difference_db
        finite = np.isfinite(difference)
        step = np.floor(incidence_deg[finite] / INCIDENCE_STEP_DEG).astype(int)
        bins = []
        for number in np.unique(step):
            chosen = np.flatnonzero(finite)[step == number]
            gamma, sionna = self.gamma.power[chosen].sum(), self.sionna.power[chosen].sum()
            entry = IncidenceBin(
                incidence_deg=float(number + 0.5) * INCIDENCE_STEP_DEG,
                pulses=len(chosen),
                mean_power_difference_db=_ratio_db(gamma, sionna),
                std_power_difference_db=float(difference[chosen].std()),
            )
            bins.append(entry)
        return bins

    def power_trend_db_per_10deg(self) -> float:
        """Return the slope of the power difference over the incidence: least squares over pulses."""
        incidence, difference = self.sionna.incidence_rad, self.power_difference_db
        finite = np.isfinite(difference)
        if finite.sum() < 2 or np.ptp(incidence[finite]) == 0:
            return math.nan
        return float(np.polyfit(np.rad2deg(incidence[finite]) / 10, difference[finite], 1)[0])

    def common(self) -> Bool[np.ndarray, "row column"]:
        """Return the cells that all four DEMs fill."""
        filled = self.sionna.dem.filled & self.sionna_again.dem.filled
        return filled & self.gamma.dem.filled & self.gamma_again.dem.filled

    def rms_m(self, one: EngineResult, other: EngineResult) -> float:
        """Return the RMS difference of two DEMs where all four are filled."""
        common = self.common()
        if not common.any():
            return math.nan
        return float(np.sqrt(np.mean((one.dem.height_m[common] - other.dem.height_m[common]) ** 2)))

    def mean_m(self) -> float:
        """Return the mean difference of the engines, over both seeds of each."""
        common = self.common()
        if not common.any():
            return math.nan
        gamma = self.gamma.dem.height_m[common] + self.gamma_again.dem.height_m[common]
        sionna = self.sionna.dem.height_m[common] + self.sionna_again.dem.height_m[common]
        return float(np.mean(gamma - sionna) / 2)


def _difference_db(result: EngineResult, reference: EngineResult) -> Float[np.ndarray, " pulse"]:
    """Return the ratio of each pulse's power to the reference; NaN without power in either."""
    valid = (result.power > 0) & (reference.power > 0)
    ratio = np.full(len(valid), np.nan)
    ratio[valid] = result.power[valid] / reference.power[valid]
    return 10 * np.log10(ratio)


def _ratio_db(gamma: float, sionna: float) -> float:
    return 10 * math.log10(gamma / sionna) if gamma > 0 and sionna > 0 else math.nan


def _percentile(values: Float[np.ndarray, " n"], percent: float) -> float:
    finite = values[np.isfinite(values)]
    return float(np.percentile(finite, percent)) if len(finite) else math.nan


_last_radar: list[tuple[Prepared, str, int, Radar]] = []


def crosscheck(
    scenario: Scenario, *, tolerances: Tolerances | None = None, execution: Execution | None = None
) -> CrossCheck:
    """Fly a survey with both engines, each with two seeds, and compare the results.

    Parameters
    ----------
    scenario:
        The survey; its engine and speckle are replaced (per-pulse speckle), its map by linear interpolation, and of a
        pair of sweeps the first is flown.
    tolerances:
        Tolerances of the differences.
    execution:
        As for `sionna_radar.run`; the four runs are one stage.

    Returns
    -------
    The runs of both engines; `verdict` compares their differences with the tolerances.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown, or contains point targets only.

    Examples
    --------
    >>> check = crosscheck(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> abs(check.mean_power_difference_db) < 0.1
    True
    """
    if scenario.sensor != "radar":
        message = f"{scenario.sensor!r} uses no tracing engine; set sensor = 'radar' to compare the engines"
        raise ScenarioError.of("sensor", message)
    execution = execution or Execution()
    with execution.reported():
        prepared = prepare(scenario)
        results = _observe_all(prepared, execution)
    if not (results["sionna"].power > 0).any():
        raise ScenarioError.of("terrain", "no pulse of the survey meets a surface; there is nothing to compare")
    return CrossCheck(
        scenario=scenario, tolerances=tolerances or Tolerances(), correlation_m=_correlation_m(prepared), **results
    )


def _correlation_m(prepared: Prepared) -> float:
    """Return the correlation length of DEM errors, m: a footprint, or half the largest filled gap."""
    pose = prepared.flight.sample(1000).true
    clearance = float(np.median(pose.position_m[:, 2] - prepared.world.ground_m(pose.position_m[:, :2])))
    incidence_rad = prepared.flight.scan.incidence_rad
    footprint = clearance * max(prepared.instrument.antenna.beamwidths_rad) / np.cos(incidence_rad) ** 2
    return max(float(footprint), prepared.mapper.max_gap_m / 2)


def _observe_all(prepared: Prepared, execution: Execution) -> dict[str, EngineResult]:
    """Return the result of each engine with each of its two seeds."""
    base_seed = prepared.scenario.seed
    scenario, segments = prepared.scenario.model_dump_json(), segments_of(prepared, execution.block_size)
    runs, tasks, pulses = {}, {}, {}
    for name, repeat in (("sionna", 0), ("sionna_again", 1), ("gamma", 0), ("gamma_again", 1)):
        seed = base_seed + repeat if base_seed + repeat < 2**63 else 0
        runs[name] = seed
        for blocks in segments:
            key = f"{name} {key_of(blocks)}"
            engine = "gamma" if name.startswith("gamma") else "sionna"
            tasks[key] = {"scenario": scenario, "engine": engine, "seed": seed, "blocks": blocks}
            pulses[key] = blocks[-1][1] - blocks[0][0]
    shared = None if execution.distributed else prepared
    with stage("tracing", 4 * len(prepared)):
        results = dict(execution.done(tasks, engine_task, shared=shared, steps=pulses))
    return {
        name: _joined(prepared, seed, [columns_of(results[f"{name} {key_of(blocks)}"]) for blocks in segments])
        for name, seed in runs.items()
    }


def _joined(prepared: Prepared, seed: int, segments: Sequence[Mapping[str, Any]]) -> EngineResult:
    """Return the result of an engine over a survey, joined from its segments."""
    names = ("power", "range_m", "incidence_rad", "echo_range_m")
    points = Points.concatenate([table_of(Points, "points", dict(columns)) for columns in segments])
    return EngineResult(
        seed=seed,
        **{name: np.concatenate([columns[name] for columns in segments]) for name in names},
        dem=Linear()(prepared.mapper.inputs(points)).dem,
    )


def engine_task(task: Task) -> bytes:
    """Return the packed observations of a task's engine over its segment."""
    prepared = task[SHARED] or on_this_worker(task["scenario"])[0]
    return _observe(prepared, task["engine"], task["seed"], [(start, end) for start, end in task["blocks"]])


@on_one_thread
def _observe(prepared: Prepared, engine: str, seed: int, blocks: Sequence[tuple[int, int]]) -> bytes:
    """Observe some blocks with an engine; noise, weather and targets are those of the scenario's seed."""
    radar, offset, count = _radar(prepared, engine, seed), blocks[0][0], blocks[-1][1] - blocks[0][0]
    power, range_m, incidence, echo_range_m = (np.full(count, np.nan) for _ in range(4))
    located = []
    for block in observe_blocks((prepared.flight.pulses(np.arange(*bounds)) for bounds in blocks), radar):
        pulses, index = block.pulses, block.pulses.index
        echoes = radar.correct(block.observation.echoes, index, pulses.measured)
        row = index - offset
        power[row], range_m[row], incidence[row] = _means(block.observation.paths, int(index[0]), len(index))
        order = np.argsort(echoes.power, kind="stable")
        echo_range_m[echoes.pulse[order] - offset] = echoes.range_m[order]
        located.append(locate(echoes, index, pulses.measured))
    return packed(
        power=power,
        range_m=range_m,
        incidence_rad=incidence,
        echo_range_m=echo_range_m,
        points=Points.concatenate(located),
    )


def _radar(prepared: Prepared, engine: str, seed: int) -> Radar:
    """Return a radar with an engine, cached for the consecutive segments of a run."""
    for cached, *settings, radar in _last_radar:
        if cached is prepared and settings == [engine, seed]:
            return radar
    update = {"engine": engine, "speckle": "per_pulse", "decorrelation_time_s": None}
    table = prepared.local.tracing.model_copy(update=update)

    def build(inputs: EngineInputs) -> Engine:
        return build_engine(table, replace(inputs, tracing=table, seed=seed))

    # Of a pair of sweeps only the first is compared.
    receiver = replace(prepared.receiver, sweeps=prepared.receiver.sweeps[:1])
    radar = Radar(replace(prepared.sensor_inputs(), custom_engine=build, receiver=receiver))
    _last_radar[:] = [(prepared, engine, seed, radar)]
    return radar


def _means(
    paths: Paths, first_pulse: int, count: int
) -> tuple[Float[np.ndarray, " pulse"], Float[np.ndarray, " pulse"], Float[np.ndarray, " pulse"]]:
    """Return power, mean range and mean incidence of the surfaces' paths of a block."""
    on_surface = paths.surface >= 0
    pulse = paths.pulse[on_surface] - first_pulse
    weight = np.abs(paths.gain[on_surface].astype(np.complex128)) ** 2
    total, by_delay, by_incidence = (
        np.bincount(pulse, weight * column, minlength=count)
        for column in (1.0, paths.delay_s[on_surface], paths.incidence_rad[on_surface])
    )
    with np.errstate(invalid="ignore"):
        return total, by_delay / total * (speed_of_light / 2), by_incidence / total
