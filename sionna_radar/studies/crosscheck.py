"""Cross-check of the electromagnetic engine and the paper's facets over one survey, and gamma fits of materials.

Both trace the same pulses over the same meshes. The power of a pulse's echo is compared as the sum of
|gain|^2 over its paths, that is before they interfere, so it is free of speckle and the engines must agree
closely. The DEMs are made of speckled echoes, and each engine draws its own speckle: two seeds of ONE engine
already differ. So each engine flies with two seeds, all four cross pairs are compared with the two pairs of one
engine, and `speckle_test` gives the probability that speckle alone makes such a difference. The noise of the
receiver, the rain and the fluctuation of targets are the same in all four.

What the two share is not checked by this: Mitsuba's ray casting (shadows), the antenna's pattern, the models of
backscatter, point targets, and mirror reflections, which are traced apart from both engines and added to each. Where
a mirror outshines the diffuse echo the engines agree because it is one and the same.

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

from sionna_radar.accuracy.compare import SpeckleTest, compare_speckle
from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import SHARED, Failure, Task
from sionna_radar.foundation.columns import columns_of, packed, table_of
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.numerics import on_one_thread
from sionna_radar.foundation.progress import stage
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.linear.linear import Linear
from sionna_radar.mapping.points import Points, locate
from sionna_radar.scenario import Scenario
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.material import build_materials
from sionna_radar.survey.observation import key_of, observe_blocks, on_this_worker, segments_of
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.sensors.radar import Radar
from sionna_radar.tracing.engine import Engine, EngineInputs, build_engine
from sionna_radar.tracing.paths import Paths

INCIDENCE_STEP_DEG = 5.0


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """How far the engines may lie apart.

    mean_power_db: size of the difference of the mean power over all pulses, beside the scatter of both engines.
    p95_power_db: size of the difference of a pulse's power that 95 pulses in 100 stay within, unless both engines
        scatter by more: a few hundred rays meet an edge of a building, and scatterers whose polarization is drawn, as
        a circular wave shows it, differ in power.
    false_alarm_probability: how rarely scatter and speckle alone may be called a difference.
    dem_factor: RMS difference of the DEMs over what speckle explains, up to which a difference, even a certain
        one, is too small to matter.
    """

    mean_power_db: float = 0.1
    p95_power_db: float = 0.5
    false_alarm_probability: float = 1e-3
    dem_factor: float = 1.25


@dataclass(frozen=True, kw_only=True)
class EngineResult:
    """What one engine made of every pulse, and the DEM of it all.

    power: sum of |gain|^2 over the surfaces' paths; a ratio to the sent power.
    range_m, incidence_rad: means over those paths, weighted by power; NaN without any.
    echo_range_m: range of the strongest echo detected, with its speckle; NaN without any.
    """

    seed: int
    power: Float[np.ndarray, " pulse"]
    range_m: Float[np.ndarray, " pulse"]
    incidence_rad: Float[np.ndarray, " pulse"]
    echo_range_m: Float[np.ndarray, " pulse"]
    dem: Raster


@dataclass(frozen=True, kw_only=True)
class IncidenceBin:
    """The difference of power (gamma over Sionna) of pulses by their mean local incidence."""

    incidence_deg: float
    pulses: int
    mean_power_difference_db: float
    std_power_difference_db: float


@dataclass(frozen=True, kw_only=True)
class CrossCheck:
    """Both engines' runs, each with a second seed; differences are gamma minus Sionna.

    tolerances: how far the engines may lie apart.
    correlation_m: distance over which errors of a DEM are correlated.
    sionna, sionna_again, gamma, gamma_again: what each engine made of every pulse, with either seed.

    Examples
    --------
    >>> check = run_crosscheck(load_scenario("hills", {"platform.length_m": 10.0}))
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
        """Difference of each pulse's power, before interference; NaN where an engine found none."""
        return _difference_db(self.gamma, self.sionna)

    @property
    def mean_power_difference_db(self) -> float:
        """Difference of the mean power over all pulses."""
        return _ratio_db(self.gamma.power.sum(), self.sionna.power.sum())

    @property
    def p95_abs_power_difference_db(self) -> float:
        """Size of the difference of a pulse's power that 95 pulses in 100 stay within."""
        return _percentile(np.abs(self.power_difference_db), 95.0)

    @property
    def mean_power_scatter_db(self) -> float:
        """Standard deviation of the difference of the mean power: pulses are drawn anew, so their variances add.

        Half the square of what two seeds of an engine differ by is the variance of one, pulse by pulse.
        """
        variance = 0.0
        for one, other in ((self.sionna, self.sionna_again), (self.gamma, self.gamma_again)):
            mean = (one.power.sum() + other.power.sum()) / 2
            variance += float(np.sum((one.power - other.power) ** 2) / 2 / mean**2) if mean > 0 else 0.0
        return 10 / math.log(10) * math.sqrt(variance)

    @property
    def p95_power_scatter_db(self) -> float:
        """Size of a pulse's difference that 95 in 100 would stay within if scatter alone made it.

        What two seeds of one engine differ by has twice its variance, so that the sum of that of both engines has twice
        the variance of the difference of one run of each. Both percentiles are those of as many pulses as there are:
        the order statistic is taken that is lower than the other's with the false-alarm probability.
        """
        both = _difference_db(self.sionna, self.sionna_again) + _difference_db(self.gamma, self.gamma_again)
        count = int(np.isfinite(both).sum())
        above = self._sigmas * math.sqrt(2 * 0.95 * 0.05 / max(count, 1))
        return _percentile(np.abs(both) / math.sqrt(2), min(95.0 + 100 * above, 100.0))

    @property
    def _sigmas(self) -> float:
        """Standard deviations of a Gaussian that the false-alarm probability stands for."""
        return float(ndtri(1 - self.tolerances.false_alarm_probability))

    @property
    def dem_difference(self) -> Raster:
        """Gamma's DEM minus Sionna's."""
        return Raster(grid=self.gamma.dem.grid, height_m=self.gamma.dem.height_m - self.sionna.dem.height_m)

    @cached_property
    def dem_test(self) -> SpeckleTest:
        """Whether the engines' DEMs differ by more than speckle."""
        return compare_speckle(
            (self.sionna.dem, self.sionna_again.dem), (self.gamma.dem, self.gamma_again.dem), self.correlation_m
        )

    @property
    def dem_rms_difference_m(self) -> float:
        """RMS difference of the engines' DEMs, all pairs of seeds, where all four are filled."""
        return self.dem_test.cross_rms_m

    @property
    def dem_speckle_rms_m(self) -> float:
        """RMS difference that independent speckle alone would make between the engines' DEMs."""
        return self.dem_test.speckle_rms_m

    @property
    def agrees(self) -> bool:
        """Whether every difference lies within its tolerance; one that does not exist does not."""
        return all(entry["agrees"] for entry in self.verdict().values())

    def verdict(self) -> dict[str, dict[str, Any]]:
        """Return each difference that is judged with its tolerance."""
        limits = {
            "mean_power_difference_db": (
                self.mean_power_difference_db,
                self.tolerances.mean_power_db + self._sigmas * self.mean_power_scatter_db,
            ),
            "p95_abs_power_difference_db": (
                self.p95_abs_power_difference_db,
                float(np.fmax(self.tolerances.p95_power_db, self.p95_power_scatter_db)),
            ),
        }
        verdict: dict[str, dict[str, Any]] = {
            name: {"value": value, "tolerance": limit, "agrees": abs(value) <= limit}
            for name, (value, limit) in limits.items()
        }
        test, limit = self.dem_test, self.tolerances.dem_factor * self.dem_speckle_rms_m
        # A map of too few tiles cannot separate chance from difference; its size alone decides.
        by_chance = test.can_reject(self.tolerances.false_alarm_probability) and (
            test.probability > self.tolerances.false_alarm_probability
        )
        verdict["dem_rms_difference_m"] = {
            "value": test.cross_rms_m,
            "tolerance": limit,
            "probability": test.probability,
            "agrees": by_chance or test.cross_rms_m <= limit,
        }
        return verdict

    def by_incidence(self) -> list[IncidenceBin]:
        """Return the difference of power in steps of the mean local incidence."""
        incidence_deg, difference = np.rad2deg(self.sionna.incidence_rad), self.power_difference_db
        known = np.isfinite(difference)
        step = np.floor(incidence_deg[known] / INCIDENCE_STEP_DEG).astype(int)
        bins = []
        for number in np.unique(step):
            chosen = np.flatnonzero(known)[step == number]
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
        """Return the slope of the difference of power over the incidence: least squares over pulses."""
        incidence, difference = self.sionna.incidence_rad, self.power_difference_db
        known = np.isfinite(difference)
        if known.sum() < 2 or np.ptp(incidence[known]) == 0:
            return math.nan
        return float(np.polyfit(np.rad2deg(incidence[known]) / 10, difference[known], 1)[0])

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


def _difference_db(one: EngineResult, other: EngineResult) -> Float[np.ndarray, " pulse"]:
    """Return one's power of each pulse over the other's; NaN where either found none."""
    both = (one.power > 0) & (other.power > 0)
    ratio = np.full(len(both), np.nan)
    ratio[both] = one.power[both] / other.power[both]
    return 10 * np.log10(ratio)


def _ratio_db(gamma: float, sionna: float) -> float:
    return 10 * math.log10(gamma / sionna) if gamma > 0 and sionna > 0 else math.nan


def _percentile(values: Float[np.ndarray, " n"], percent: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percent)) if len(known) else math.nan


_last_radar: list[tuple[Prepared, str, int, Radar]] = []


def run_crosscheck(
    scenario: Scenario,
    *,
    tolerances: Tolerances | None = None,
    execution: Execution | None = None,
) -> CrossCheck:
    """Fly a survey with both engines, each with two seeds, and compare what they find.

    Parameters
    ----------
    scenario:
        The survey; its own choice of engine does not matter.
    tolerances:
        How far the engines may lie apart.
    execution:
        As for `sionna_radar.run`; the four runs are one stage.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown, or has nothing but point targets to see.

    Examples
    --------
    >>> check = run_crosscheck(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> abs(check.mean_power_difference_db) < 0.1
    True

    """
    if scenario.sensor != "radar":
        message = f"{scenario.sensor!r} uses no tracing engine; set sensor = 'radar' to compare the engines"
        raise ScenarioError([Problem("sensor", message)])
    execution = execution or Execution()
    with execution.reported():
        prepared = prepare(scenario)
        results = _observe_all(prepared, execution)
    if not (results["sionna"].power > 0).any():
        message = "no pulse of the survey meets a surface; there is nothing to compare"
        raise ScenarioError([Problem("terrain", message)])
    return CrossCheck(
        scenario=scenario, tolerances=tolerances or Tolerances(), correlation_m=_correlation_m(prepared), **results
    )


def _correlation_m(prepared: Prepared) -> float:
    """Return the correlation length of DEM errors, m: a footprint, or half the gap that is filled."""
    pose = prepared.flight.sample(1000).true
    clearance = float(np.median(pose.position_m[:, 2] - prepared.scene.ground_m(pose.position_m[:, :2])))
    incidence_rad = prepared.flight.scan.incidence_rad
    footprint = clearance * max(prepared.antenna.beamwidths_rad) / np.cos(incidence_rad) ** 2
    return max(float(footprint), prepared.mapper.max_gap_m / 2)


def _observe_all(prepared: Prepared, execution: Execution) -> dict[str, EngineResult]:
    """Return the result of each engine with each of its two seeds."""
    first = prepared.scenario.seed
    scenario, segments = prepared.scenario.model_dump_json(), segments_of(prepared, execution.block_size)
    runs, tasks, pulses = {}, {}, {}
    for name, repeat in (("sionna", 0), ("sionna_again", 1), ("gamma", 0), ("gamma_again", 1)):
        seed = first + repeat if first + repeat < 2**63 else 0
        runs[name] = seed
        for blocks in segments:
            key = f"{name} {key_of(blocks)}"
            engine = "gamma" if name.startswith("gamma") else "sionna"
            tasks[key] = {"scenario": scenario, "engine": engine, "seed": seed, "blocks": blocks}
            pulses[key] = blocks[-1][1] - blocks[0][0]
    found: dict[str, bytes] = {}
    shared = None if execution.distributed else prepared
    with stage("tracing", 4 * len(prepared)):
        for key, result in execution.over(tasks, engine_task, shared=shared, steps=pulses):
            if isinstance(result, Failure):
                raise result.error()
            found[key] = result
    return {
        name: _joined(prepared, seed, [columns_of(found[f"{name} {key_of(blocks)}"]) for blocks in segments])
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
    """Return the bytes of what the engine of a task observes over its segment."""
    prepared = task[SHARED] or on_this_worker(task["scenario"])[0]
    return _observe(prepared, task["engine"], task["seed"], [(first, end) for first, end in task["blocks"]])


@on_one_thread
def _observe(prepared: Prepared, engine: str, seed: int, blocks: Sequence[tuple[int, int]]) -> bytes:
    """Observe some blocks with an engine; noise, weather and targets are those of the scenario's seed."""
    radar, offset, count = _radar(prepared, engine, seed), blocks[0][0], blocks[-1][1] - blocks[0][0]
    power, range_m, incidence, echo_range_m = (np.full(count, np.nan) for _ in range(4))
    located = []
    for block in observe_blocks((prepared.flight.pulses(np.arange(*bounds)) for bounds in blocks), radar):
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
    """Return a radar with an engine: the last one again, as the segments of a run come one after another."""
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


STEP_DEG = 1.0
TOLERANCE_DB = 1.5
# Angles called near nadir and near grazing.
NEAR_NADIR_DEG, NEAR_GRAZING_DEG = 20.0, 70.0


@dataclass(frozen=True, kw_only=True)
class GammaFit:
    """A constant gamma and how well it serves.

    gamma_db: the mean of sigma0 over cos, both in dB, over the span: least squares in dB.
    incidence_deg, sigma0_db: the material at whole degrees from 0 to 89; -inf where it scatters nothing.
    residual_db: material minus gamma cos, there.
    fitted: the angles of the span.
    """

    gamma_db: float
    incidence_deg: Float[np.ndarray, " n"]
    sigma0_db: Float[np.ndarray, " n"]
    residual_db: Float[np.ndarray, " n"]
    fitted: Bool[np.ndarray, " n"]

    @property
    def rms_db(self) -> float:
        """Root mean square of the residual over the span."""
        return float(np.sqrt(np.mean(self.residual_db[self.fitted] ** 2)))

    @property
    def failures(self) -> list[str]:
        """Where gamma misses the material by more than the tolerance, in words."""
        wrong = np.abs(self.residual_db) > TOLERANCE_DB
        starts = np.flatnonzero(wrong & ~np.concatenate([[False], wrong[:-1]]))
        ends = np.flatnonzero(wrong & ~np.concatenate([wrong[1:], [False]]))
        return [self._describe(slice(a, b + 1)) for a, b in zip(starts, ends, strict=True)]

    def _describe(self, run: slice) -> str:
        first, last = self.incidence_deg[run][[0, -1]]
        residual = self.residual_db[run]
        worst = residual[np.argmax(np.abs(residual))]
        place = "near nadir" if first < NEAR_NADIR_DEG else "near grazing" if last > NEAR_GRAZING_DEG else "between"
        way = "too weak" if worst > 0 else "too strong"
        return f"{first:g} to {last:g} deg ({place}): constant gamma is {way}, by up to {abs(worst):.1f} dB"


def fit_gamma(material: Backscatter, from_deg: float = 20.0, to_deg: float = 70.0) -> GammaFit:
    """Return the constant gamma that fits a material best between two incidence angles.

    Raises ScenarioError for a span that is none, or a material that scatters nothing there.
    """
    if not 0 <= from_deg < to_deg < 90:
        message = f"{from_deg:g} to {to_deg:g} deg is not a span of incidence; give 0 <= from < to < 90"
        raise ScenarioError([Problem("--from-deg", message)], "command line")
    angle_deg = np.arange(0.0, 90.0, STEP_DEG)
    with np.errstate(divide="ignore"):
        sigma0_db = 10 * np.log10(material.sigma0(np.deg2rad(angle_deg)))
    over_cosine_db = sigma0_db - 10 * np.log10(np.cos(np.deg2rad(angle_deg)))
    fitted = (angle_deg >= from_deg) & (angle_deg <= to_deg) & np.isfinite(sigma0_db)
    if not fitted.any():
        message = f"the material scatters nothing back from {from_deg:g} to {to_deg:g} deg in this channel"
        raise ScenarioError([Problem("--material", message)], "command line")
    gamma_db = float(over_cosine_db[fitted].mean())
    return GammaFit(
        gamma_db=gamma_db,
        incidence_deg=angle_deg,
        sigma0_db=sigma0_db,
        residual_db=over_cosine_db - gamma_db,
        fitted=fitted,
    )


def fit_material(scenario: Scenario, name: str, from_deg: float = 20.0, to_deg: float = 70.0) -> GammaFit:
    """Return the constant gamma that fits a material of a scenario best, at its carrier and polarization.

    Raises ScenarioError for a material that the scenario does not have, and as `fit_gamma` does.
    """
    tables = scenario.all_materials
    if name not in tables:
        message = f"{name!r} is not a material of the scenario; use one of {', '.join(sorted(tables))}"
        raise ScenarioError([Problem("--material", message)], "command line")
    return fit_gamma(build_materials({name: tables[name]}, scenario.radar)[name], from_deg, to_deg)
