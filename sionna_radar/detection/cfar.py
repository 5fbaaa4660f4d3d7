"""Constant false-alarm rate (CFAR) detection: a cell is detected above a multiple of the noise around it.

Training cells lie one range cell apart on both sides of the cell under test, beyond the guard cells. Their noise
level Z is the mean of all (CA), of the side with the greater (GO) or the smaller mean (SO), or an order statistic
of all (OS). The cell is detected above a multiple of Z that follows from the specified probability of false alarm: see
`false_alarm`.

Near the ends of the spectrum, where only one side fits, that side alone is used, with a separate multiple.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, no_type_check

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.detection.false_alarm import (
    factor_of_greater,
    factor_of_mean,
    factor_of_ordered,
    factor_of_smaller,
    log_probability_over_greater,
    log_probability_over_mean,
    log_probability_over_smaller,
    mean_ordered,
    mean_smaller,
    mean_weights,
    probability_over_ordered,
)
from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.threads import chunks_of_bytes, over_rows


@dataclass(frozen=True, kw_only=True, eq=False)
class Cfar:
    """A detector for one spectrum layout.

    guard, training: range cells on each side.
    rank: order statistic of OS, as a fraction of the number of cells.
    stride: spectrum bins per range cell.
    correlation: of the complex noise by lag in range cells, from lag 0; [1] for independent cells.
    looks: powers averaged in each cell; for several, only CA has a known false-alarm rate.
    """

    kind: Literal["CA", "GO", "SO", "OS"]
    guard: int
    training: int
    false_alarm_probability: float
    rank: float = 0.75
    stride: int = 1
    correlation: Float[np.ndarray, " lag"]
    looks: int = 1

    @cached_property
    def both_sides_factor(self) -> float:
        """Threshold over noise level where both sides fit."""
        match self.kind:
            case "CA":
                return factor_of_mean(self._weights, 2, self.false_alarm_probability, self.looks)
            case "GO":
                return factor_of_greater(self._weights, self.false_alarm_probability)
            case "SO":
                return factor_of_smaller(self._weights, self.false_alarm_probability)
            case "OS":
                return self._ordered_factor(sides=2)

    @cached_property
    def one_side_factor(self) -> float:
        """Threshold over noise level where a single side fits."""
        if self.kind == "OS":
            return self._ordered_factor(sides=1)
        return factor_of_mean(self._weights, 1, self.false_alarm_probability, self.looks)

    @cached_property
    def both_sides_mean(self) -> float:
        """Mean noise level over the noise power where both sides fit: biased low for SO, high for GO and high ranks."""
        if self.kind == "CA":
            return 1.0
        if self.kind == "OS":
            return mean_ordered(self.correlation, self.training, 2, _rank_index(self.rank, 2 * self.training))
        smaller = mean_smaller(self.correlation, self.training)
        return smaller if self.kind == "SO" else 2 - smaller

    @cached_property
    def one_side_mean(self) -> float:
        """Mean noise level over the noise power where a single side fits."""
        if self.kind == "OS":
            return mean_ordered(self.correlation, self.training, 1, _rank_index(self.rank, self.training))
        return 1.0

    def threshold(self, power: Float[np.ndarray, "pulse bin"]) -> Float[np.ndarray, "pulse bin"]:
        """Return the power that each cell must exceed; infinite where neither side fits."""
        level, two_sided = self.noise_level(power)
        return level * np.where(two_sided, self.both_sides_factor, self.one_side_factor)

    def detection_probability(self, snr: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the detection probability of speckle cells between training cells of noise alone.

        The power of a cell of speckle and noise is exponential, with 1 + snr times the mean of noise alone, so it
        exceeds kZ with the probability that noise exceeds kZ / (1 + snr) (Gandhi and Kassam 1988, "Analysis of CFAR
        processors in nonhomogeneous background", section II: a Swerling 1 target). Over several looks the speckle is
        taken to change from look to look: a Swerling 2 target.

        snr: mean power of the speckle in each cell over that of the noise.
        """
        return np.array([self._passed(self.both_sides_factor / (1 + ratio)) for ratio in snr])

    def _passed(self, factor: float) -> float:
        """Return the probability that noise exceeds `factor` times its two-sided level."""
        match self.kind:
            case "CA":
                return float(np.exp(log_probability_over_mean(self._weights, 2, factor, self.looks)))
            case "GO":
                return float(np.exp(log_probability_over_greater(self._weights, factor)))
            case "SO":
                return float(np.exp(log_probability_over_smaller(self._weights, factor)))
            case "OS":
                place = _rank_index(self.rank, 2 * self.training)
                return probability_over_ordered(self.correlation, self.training, 2, place, factor)

    def noise_level(
        self, power: Float[np.ndarray, "pulse bin"]
    ) -> tuple[Float[np.ndarray, "pulse bin"], Bool[np.ndarray, " bin"]]:
        """Return the noise estimate at each cell, and the mask of bins with both sides used."""
        bins = power.shape[1]
        reach = (self.guard + self.training) * self.stride
        cell = np.arange(bins)
        has_lag, has_lead = cell >= reach, cell + reach < bins
        two_sided = has_lag & has_lead
        if self.kind == "OS":
            return self._ranked_level(power, has_lag, has_lead), two_sided
        return self._mean_level(power), two_sided

    def _mean_level(self, power: Float[np.ndarray, "pulse bin"]) -> Float[np.ndarray, "pulse bin"]:

        kind = {"CA": CELL_AVERAGING, "GO": GREATEST_OF, "SO": SMALLEST_OF}[self.kind]
        power, level = np.ascontiguousarray(power, dtype=np.float64), np.empty(power.shape)
        cells = kind, self.guard, self.training, self.stride
        # Running sums of whole range cells, and one more.
        room = self.stride * (-(-power.shape[1] // self.stride) + 1)
        over_rows(lambda low, high: mean_levels(low, high, power, *cells, np.zeros(room), level), len(power))
        return level

    def _ranked_level(
        self,
        power: Float[np.ndarray, "pulse bin"],
        has_lag: Bool[np.ndarray, " bin"],
        has_lead: Bool[np.ndarray, " bin"],
    ) -> Float[np.ndarray, "pulse bin"]:
        offsets = self.stride * np.arange(self.guard + 1, self.guard + self.training + 1)
        cell = np.arange(power.shape[1])
        level = np.full(power.shape, np.inf)
        for use, steps in (
            (has_lag & has_lead, np.concatenate([-offsets, offsets])),
            (has_lag & ~has_lead, -offsets),
            (~has_lag & has_lead, offsets),
        ):
            if not use.any():
                continue
            index = cell[use][:, None] + steps
            for low, high in chunks_of_bytes(len(power), 8 * index.size):
                rows = slice(low, high)
                place = _rank_index(self.rank, index.shape[1])
                level[rows, use] = np.partition(power[rows][:, index], place, axis=-1)[..., place]
        return level

    @property
    def _weights(self) -> Float[np.ndarray, " cell"]:
        return mean_weights(self.correlation, self.training)

    def _ordered_factor(self, sides: int) -> float:
        place = _rank_index(self.rank, sides * self.training)
        return factor_of_ordered(self.correlation, self.training, sides, place, self.false_alarm_probability)


def _rank_index(rank: float, cells: int) -> int:
    """Return the index, in increasing order from 0, of the cell at a rank."""
    return max(0, int(np.ceil(rank * cells)) - 1)


CELL_AVERAGING, GREATEST_OF, SMALLEST_OF = 0, 1, 2


@compiled
@no_type_check
def mean_levels(low, high, power, kind, guard, training, stride, running, level):
    """Write to `level` the noise of rows `low` to `high` - 1; infinite where neither side's cells fit.

    stride: bins per range cell; the training cells of a bin are whole cells away from it.
    running: room for running sums at cell spacing, interleaved by bin; zero at its beginning.
    """
    bins = power.shape[1]
    cells, reach = len(running) // stride - 1, (guard + training) * stride
    for row in range(low, high):
        for k in range(cells * stride):
            running[k + stride] = running[k] + (power[row, k] if k < bins else 0.0)
        for b in range(bins):
            lag = lead = 0.0
            below, above = b >= reach, b + reach < bins
            if below:
                to = b - guard * stride
                lag = max((running[to] - running[to - training * stride]) / training, 0.0)
            if above:
                start = b + (guard + 1) * stride
                lead = max((running[start + training * stride] - running[start]) / training, 0.0)
            if not below or not above:
                level[row, b] = lag if below else lead if above else np.inf
            elif kind == CELL_AVERAGING:
                level[row, b] = (lag + lead) / 2
            else:
                level[row, b] = max(lag, lead) if kind == GREATEST_OF else min(lag, lead)
