"""What a cross-check of the two engines found; see `crosscheck` for how."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtri

from sionna_radar.accuracy.speckle import SpeckleTest, compare_speckle
from sionna_radar.foundation.brief import Brief
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario import Scenario

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
class CrossCheck(Brief):
    """Both engines' runs, each with a second seed; differences are gamma minus Sionna.

    tolerances: how far the engines may lie apart.
    correlation_m: distance over which errors of a DEM are correlated.
    sionna, sionna_again, gamma, gamma_again: what each engine made of every pulse, with either seed.

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
