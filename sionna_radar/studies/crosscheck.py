"""Two engines compared over one survey: the electromagnetic one and the paper's facets.

Both trace the same pulses over the same meshes. The power of a pulse's echo is compared as the sum of
|gain|^2 over its paths, that is before they interfere, so it bears no speckle and the engines must agree
closely. The DEMs are made of speckled echoes, and each engine draws its own speckle: two seeds of ONE engine
already differ. So each engine flies with two seeds, all four cross pairs are compared with the two pairs of one
engine, and `speckle_test` gives the probability that speckle alone makes such a difference. The noise of the
receiver, the rain and the fluctuation of targets are the same in all four.

What the two share is not checked by this: Mitsuba's ray casting (shadows), the antenna's pattern, the models of
backscatter, point targets, and mirror reflections, which are traced apart from both engines and added to each. Where
a mirror outshines the diffuse echo the engines agree because it is one and the same.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.constants import speed_of_light

from sionna_radar.accuracy.speckle import SpeckleTest, compare_speckle
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.points import Points, locate
from sionna_radar.report.folder import without_nan, write_study
from sionna_radar.scenario import Scenario
from sionna_radar.survey.chain import BLOCK_SIZE, fly, grid_dem
from sionna_radar.survey.preparation import Preparation, prepare
from sionna_radar.survey.sensors import SawtoothRadar, engine_inputs, tracer_with
from sionna_radar.survey.warnings import Brief
from sionna_radar.tracing.engine import Engine, build_engine
from sionna_radar.tracing.paths import Paths

MARKER = "crosscheck.json"
INCIDENCE_STEP_DEG = 5.0
SPECKLE = (
    "Powers are sums of |gain|^2 over a pulse's paths, free of speckle. The DEMs are not: two seeds of one "
    "engine already differ. dem_rms_difference_m is over all four pairs of a Sionna and a gamma run; "
    "dem_speckle_rms_m, over the pairs of one engine, is what speckle alone makes of it; dem_probability is the "
    "chance of such a difference by speckle alone (randomisation test over dem_tiles tiles of the map)."
)
SHARED = (
    "Both engines share the ray casting, the antenna, the models of backscatter, the point targets and the mirror "
    "reflections; the cross-check says nothing about those."
)


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """How far the engines may lie apart.

    mean_power_db: size of the difference of the mean power over all pulses.
    p95_power_db: size of the difference of a pulse's power that 95 pulses in 100 stay within. It bears the
        sampling of the Sionna engine, which meets an edge of a building with a few hundred rays; where two seeds of
        that engine differ by more, that is the tolerance.
    dem_false_alarm_probability: how rarely speckle alone may be called a difference of the DEMs.
    dem_factor: RMS difference of the DEMs over what speckle explains, up to which a difference, even a certain
        one, is too small to matter.
    """

    mean_power_db: float = 0.1
    p95_power_db: float = 0.5
    dem_false_alarm_probability: float = 1e-3
    dem_factor: float = 1.25


@dataclass(frozen=True, kw_only=True)
class EngineRun:
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
class CrossCheck(Brief):
    """Both engines' runs, each with a second seed; differences are gamma minus Sionna.

    correlation_m: distance over which errors of a DEM are correlated.
    """

    scenario: Scenario
    tolerances: Tolerances
    correlation_m: float
    sionna: EngineRun
    sionna_again: EngineRun
    gamma: EngineRun
    gamma_again: EngineRun

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
        both = (self.sionna.power > 0) & (self.gamma.power > 0)
        ratio = np.full(len(both), np.nan)
        ratio[both] = self.gamma.power[both] / self.sionna.power[both]
        return 10 * np.log10(ratio)

    @property
    def mean_power_difference_db(self) -> float:
        """Difference of the mean power over all pulses."""
        return _ratio_db(self.gamma.power.sum(), self.sionna.power.sum())

    @property
    def p95_abs_power_difference_db(self) -> float:
        """Size of the difference of a pulse's power that 95 pulses in 100 stay within."""
        return _percentile(np.abs(self.power_difference_db), 95.0)

    @property
    def p95_abs_power_of_sionna_seeds_db(self) -> float:
        """What two seeds of the Sionna engine differ by, in 95 pulses of 100: its sampling of the beam, twice."""
        one, other = self.sionna.power, self.sionna_again.power
        both = (one > 0) & (other > 0)
        return _percentile(np.abs(10 * np.log10(one[both] / other[both])), 95.0)

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
            "mean_power_difference_db": (self.mean_power_difference_db, self.tolerances.mean_power_db),
            "p95_abs_power_difference_db": (
                self.p95_abs_power_difference_db,
                float(np.fmax(self.tolerances.p95_power_db, self.p95_abs_power_of_sionna_seeds_db)),
            ),
        }
        verdict: dict[str, dict[str, Any]] = {
            name: {"value": value, "tolerance": limit, "agrees": abs(value) <= limit}
            for name, (value, limit) in limits.items()
        }
        test, limit = self.dem_test, self.tolerances.dem_factor * self.dem_speckle_rms_m
        # A map of too few tiles cannot separate chance from difference; its size alone decides.
        by_chance = test.can_reject(self.tolerances.dem_false_alarm_probability) and (
            test.probability > self.tolerances.dem_false_alarm_probability
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

    def summary(self) -> dict[str, Any]:
        """Return the numbers of the comparison in strict JSON form; a number that does not exist is None."""
        again = self.sionna_again.echo_range_m
        document: dict[str, Any] = {
            "agrees": self.agrees,
            "mean_power_difference_db": self.mean_power_difference_db,
            "p95_abs_power_difference_db": self.p95_abs_power_difference_db,
            "p95_abs_power_of_sionna_seeds_db": self.p95_abs_power_of_sionna_seeds_db,
            "power_difference_db": _spread(self.power_difference_db),
            "power_trend_db_per_10deg": self.power_trend_db_per_10deg(),
            "power_by_incidence": [asdict(entry) for entry in self.by_incidence()],
            "range_difference_m": _spread(self.gamma.range_m - self.sionna.range_m),
            "echo_range_difference_m": _spread(self.gamma.echo_range_m - self.sionna.echo_range_m),
            "echo_range_difference_of_seeds_m": _spread(again - self.sionna.echo_range_m),
            "dem_rms_difference_m": self.dem_rms_difference_m,
            "dem_mean_difference_m": self._mean(),
            "dem_speckle_rms_m": self.dem_speckle_rms_m,
            "dem_probability": self.dem_test.probability,
            "dem_tiles": self.dem_test.tiles,
            "dem_rms_of_sionna_seeds_m": self._rms(self.sionna_again, self.sionna),
            "dem_rms_of_gamma_seeds_m": self._rms(self.gamma_again, self.gamma),
            "dem_cells": int(self._common().sum()),
            "pulses": len(self.sionna.power),
            "seeds": [self.sionna.seed, self.sionna_again.seed],
            "tolerances": asdict(self.tolerances),
            "verdict": self.verdict(),
            "speckle": SPECKLE,
            "shared": SHARED,
            "scenario": self.scenario.model_dump(mode="json"),
        }
        return without_nan(document)

    def _common(self) -> Bool[np.ndarray, "row column"]:
        filled = self.sionna.dem.filled & self.sionna_again.dem.filled
        return filled & self.gamma.dem.filled & self.gamma_again.dem.filled

    def _rms(self, one: EngineRun, other: EngineRun) -> float:
        common = self._common()
        if not common.any():
            return math.nan
        return float(np.sqrt(np.mean((one.dem.height_m[common] - other.dem.height_m[common]) ** 2)))

    def _mean(self) -> float:
        """Return the mean difference of the engines, over both seeds of each."""
        common = self._common()
        if not common.any():
            return math.nan
        gamma = self.gamma.dem.height_m[common] + self.gamma_again.dem.height_m[common]
        sionna = self.sionna.dem.height_m[common] + self.sionna_again.dem.height_m[common]
        return float(np.mean(gamma - sionna) / 2)


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

    """
    progress("preparing", 0, 0)
    ready = prepare(scenario)
    progress("preparing", 1, 1)
    total = 4 * len(ready.schedule)
    runs: dict[str, EngineRun] = {}
    for name, repeat in (("sionna", 0), ("sionna_again", 1), ("gamma", 0), ("gamma_again", 1)):
        seed = scenario.seed + repeat if scenario.seed + repeat < 2**63 else 0
        engine = _gamma(ready, seed) if name.startswith("gamma") else _sionna(ready, seed)
        offset = len(runs) * len(ready.schedule)
        runs[name] = _fly(ready, engine, seed, block_size, partial(_report, progress, offset, total))
    if not (runs["sionna"].power > 0).any():
        message = "no pulse of the survey meets a surface; there is nothing to compare"
        raise ScenarioError([Problem("terrain", message)])
    return CrossCheck(
        scenario=scenario, tolerances=tolerances or Tolerances(), correlation_m=_correlation_m(ready), **runs
    )


def _correlation_m(ready: Preparation) -> float:
    """Return how far apart errors of the DEM still belong together: a footprint, or the gap that is filled."""
    pose = ready.schedule.sample(1000).true
    clearance = float(np.median(pose.position_m[:, 2] - ready.built.ground_m(pose.position_m[:, :2])))
    incidence_rad = np.deg2rad(ready.scenario.radar.scan.incidence_deg)
    footprint = clearance * max(ready.antenna.beamwidths_rad) / np.cos(incidence_rad) ** 2
    return max(float(footprint), ready.max_gap_m / 2)


def _report(progress: Progress, offset: int, total: int, done: int) -> None:
    progress("tracing", offset + done, total)


def _sionna(ready: Preparation, seed: int) -> Engine:
    table = ready.scenario.tracing.model_copy(update={"engine": "sionna", "speckle": "per_pulse"})
    return build_engine(table, replace(engine_inputs(ready), seed=seed))


def _gamma(ready: Preparation, seed: int) -> Engine:
    table = ready.scenario.tracing.model_copy(update={"engine": "gamma", "speckle": "per_pulse"})
    return build_engine(table, replace(engine_inputs(ready), seed=seed))


def _fly(ready: Preparation, engine: Engine, seed: int, block_size: int, progress: Callable[[int], None]) -> EngineRun:
    """Fly all pulses with an engine; the receiver's noise is that of the scenario's seed."""
    count = len(ready.schedule)
    power, range_m, incidence, echo_range_m = (np.full(count, np.nan) for _ in range(4))
    located = []
    radar = SawtoothRadar(ready, tracer=tracer_with(engine, ready))
    for block in fly(ready, radar, block_size):
        here = block.pulses.index
        echoes = radar.correct(block.seen.echoes, here, block.pulses.measured)
        power[here], range_m[here], incidence[here] = _means(block.seen.paths, int(here[0]), len(here))
        order = np.argsort(echoes.power, kind="stable")
        echo_range_m[echoes.pulse[order]] = echoes.range_m[order]
        located.append(locate(echoes, here, block.pulses.measured))
        progress(int(here[-1]) + 1)
    return EngineRun(
        seed=seed,
        power=power,
        range_m=range_m,
        incidence_rad=incidence,
        echo_range_m=echo_range_m,
        dem=grid_dem(Points.concatenate(located), ready),
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


def write(check: CrossCheck, directory: Path) -> list[Path]:
    """Write `crosscheck.json` and the figures into a directory, all or nothing, and return the files.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written; see `write_folder`.

    """
    from sionna_radar.report.crosscheck.figures import draw_all

    return write_study(directory, MARKER, check.summary(), partial(draw_all, check))


def _ratio_db(gamma: float, sionna: float) -> float:
    return 10 * math.log10(gamma / sionna) if gamma > 0 and sionna > 0 else math.nan


def _percentile(values: Float[np.ndarray, " n"], percent: float) -> float:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percent)) if len(known) else math.nan


def _spread(values: Float[np.ndarray, " n"]) -> dict[str, float]:
    """Return the middle and the width of a distribution, outliers apart and included."""
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return dict.fromkeys(("mean", "std", "median", "p95_abs"), math.nan)
    return {
        "mean": float(known.mean()),
        "std": float(known.std()),
        "median": float(np.median(known)),
        "p95_abs": float(np.percentile(np.abs(known), 95)),
    }
