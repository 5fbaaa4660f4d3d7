"""Constant false-alarm rate detection: a cell is an echo when it stands out of its neighbourhood's noise.

Training cells lie one range cell apart on both sides of the cell under test, beyond the guard cells. Their noise
level Z is the mean of all (CA), of the side with the greater (GO) or the smaller mean (SO), or an order statistic
of all (OS). The cell is detected above a multiple a of Z. Noise power in a spectrum is exponential, so the
false-alarm probability is E[exp(-a Z)], and a follows from the wanted one:

- for independent cells in closed form, as in Gandhi and Kassam 1988, "Analysis of CFAR processors in
  nonhomogeneous background";
- but a window correlates neighbouring cells. The mean of correlated exponentials is a sum of independent ones
  weighted by the eigenvalues e of their covariance: E[exp(-a Z)] = prod 1 / (1 + a e / N), exact for CA. For the
  other kinds the expectation is taken over a fixed sample of training cells with that covariance, drawn with the
  low noise at which false alarms happen and weighted back (importance sampling).

Near the ends of the spectrum, where only one side fits, that side alone serves, with a multiple of its own.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import cholesky, toeplitz
from scipy.optimize import brentq
from scipy.special import logsumexp

SAMPLE = 20_000
ROWS_AT_ONCE = 64


@dataclass(frozen=True, kw_only=True, eq=False)
class Cfar:
    """A detector for one spectrum layout.

    guard, training: range cells on each side.
    rank: which training cell OS takes, as a share of all in increasing order.
    stride: spectrum bins per range cell.
    correlation: of noise that many range cells apart, from lag 0; a bare [1] for independent cells.
    """

    kind: Literal["CA", "GO", "SO", "OS"]
    guard: int
    training: int
    false_alarm_probability: float
    rank: float = 0.75
    stride: int = 1
    correlation: Float[np.ndarray, " lag"]

    @cached_property
    def both_sides_factor(self) -> float:
        """Multiple of the noise level where both sides fit."""
        if self.kind == "CA":
            return self._mean_factor(sides=2)
        if self.kind == "SO":
            # Either side is the smaller with equal chance; it alone is then drawn low.
            lag, log_weight = self._training_sample(side=0, sides=1)
            lead, _ = self._training_sample(side=1, sides=None)
            smaller = lag.mean(axis=1) < lead.mean(axis=1)
            return self._sampled_factor(lag.mean(axis=1), np.where(smaller, log_weight + np.log(2), -np.inf))
        (lag, lag_weight), (lead, lead_weight) = (self._training_sample(side, sides=2) for side in (0, 1))
        if self.kind == "OS":
            level = _ranked(np.concatenate([lag, lead], axis=1), self.rank)
        else:
            level = np.maximum(lag.mean(axis=1), lead.mean(axis=1))
        return self._sampled_factor(level, lag_weight + lead_weight)

    @cached_property
    def one_side_factor(self) -> float:
        """Multiple of the noise level where a single side fits."""
        if self.kind == "OS":
            cells, log_weight = self._training_sample(side=0, sides=1)
            return self._sampled_factor(_ranked(cells, self.rank), log_weight)
        return self._mean_factor(sides=1)

    def threshold(self, power: Float[np.ndarray, "pulse bin"]) -> Float[np.ndarray, "pulse bin"]:
        """Return what each cell must exceed; infinite where no side fits."""
        level, both = self.noise_level(power)
        return level * np.where(both, self.both_sides_factor, self.one_side_factor)

    def noise_level(
        self, power: Float[np.ndarray, "pulse bin"]
    ) -> tuple[Float[np.ndarray, "pulse bin"], Bool[np.ndarray, " bin"]]:
        """Return the noise estimate at each cell, and whether both sides served."""
        bins = power.shape[1]
        reach = (self.guard + self.training) * self.stride
        cell = np.arange(bins)
        has_lag, has_lead = cell >= reach, cell + reach < bins
        both = has_lag & has_lead
        if self.kind == "OS":
            return self._ranked_level(power, has_lag, has_lead), both
        return self._mean_level(power, reach), both

    def _mean_level(self, power: Float[np.ndarray, "pulse bin"], reach: int) -> Float[np.ndarray, "pulse bin"]:
        lag, lead = self._side_means(power)
        # Below `reach` no cell has both sides, and from `end` on none has the upper one.
        end = max(0, power.shape[1] - reach)
        level = np.full(power.shape, np.inf)
        level[:, : min(reach, end)] = lead[:, : min(reach, end)]
        level[:, max(reach, end) :] = lag[:, max(reach, end) :]
        both = slice(reach, max(reach, end))
        if self.kind == "CA":
            level[:, both] = (lag[:, both] + lead[:, both]) / 2
        else:
            combine = np.maximum if self.kind == "GO" else np.minimum
            combine(lag[:, both], lead[:, both], out=level[:, both])
        return level

    def _side_means(
        self, power: Float[np.ndarray, "pulse bin"]
    ) -> tuple[Float[np.ndarray, "pulse bin"], Float[np.ndarray, "pulse bin"]]:
        """Return the means of the training cells below and above each cell; garbage where they do not fit."""
        rows, bins = power.shape
        cells = -(-bins // self.stride)
        padded = np.zeros((rows, cells * self.stride))
        padded[:, :bins] = power
        # Running sums from range cell to range cell, one for each bin within the cell.
        running = np.zeros((rows, cells + 1, self.stride))
        np.cumsum(padded.reshape(rows, cells, self.stride), axis=1, out=running[:, 1:])
        window = (running[:, self.training :] - running[:, : -self.training]) / self.training
        window = np.maximum(window, 0.0)
        side = np.zeros((2, rows, cells, self.stride))
        count, first = window.shape[1], self.guard + self.training
        side[0, :, first:] = window[:, : cells - first]
        side[1, :, : count - self.guard - 1] = window[:, self.guard + 1 :]
        lag, lead = side.reshape(2, rows, -1)[:, :, :bins]
        return lag, lead

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
            for start in range(0, len(power), ROWS_AT_ONCE):
                rows = slice(start, start + ROWS_AT_ONCE)
                level[rows, use] = _ranked(power[rows][:, index], self.rank)
        return level

    def _mean_factor(self, sides: int) -> float:
        """Return the multiple of the mean over one or two independent sides."""
        eigenvalue = np.linalg.eigvalsh(self._covariance())
        count = sides * self.training

        def log_miss(factor: float) -> float:
            log_probability = -sides * np.log1p(factor * eigenvalue / count).sum()
            return float(log_probability - np.log(self.false_alarm_probability))

        return float(brentq(log_miss, 0.0, 1e9, xtol=1e-10, rtol=1e-12))

    def _sampled_factor(self, level: Float[np.ndarray, " sample"], log_weight: Float[np.ndarray, " sample"]) -> float:
        def log_miss(factor: float) -> float:
            log_probability = logsumexp(log_weight - factor * level) - np.log(len(level))
            return float(log_probability - np.log(self.false_alarm_probability))

        highest = 1.0
        while log_miss(highest) > 0:
            highest *= 2
        return float(brentq(log_miss, 0.0, highest, xtol=1e-10))

    def _covariance(self) -> Float[np.ndarray, "cell cell"]:
        """Return the covariance of the powers' underlying fields over one side."""
        lags = np.zeros(self.training)
        known = self.correlation[: self.training]
        lags[: len(known)] = known
        return toeplitz(lags)

    def _training_sample(
        self, side: int, sides: int | None
    ) -> tuple[Float[np.ndarray, "sample cell"], Float[np.ndarray, " sample"]]:
        """Return powers of one side's cells under noise of unit power, and the logarithms of their weights.

        The noise is drawn at the power that makes false alarms of a level over so many sides; None draws it at
        unit power. An order statistic needs only as many low cells as its rank: that share is drawn low, each
        cell from the mixture of both powers, which also bounds the weights.
        """
        generator = np.random.default_rng([20170704, side])
        field = generator.standard_normal((SAMPLE, self.training, 2)) * np.sqrt(0.5)
        log_weight = np.zeros(SAMPLE)
        if sides is not None:
            share = self.rank if self.kind == "OS" else 1.0
            drawn = self.false_alarm_probability ** (1 / (sides * self.training * share))
            low = generator.random((SAMPLE, self.training)) < share
            field *= np.where(low, np.sqrt(drawn), 1.0)[:, :, None]
            power = (field**2).sum(axis=2)
            log_weight = -np.log1p(share * (np.exp(-power * (1 / drawn - 1)) / drawn - 1)).sum(axis=1)
        mix = cholesky(self._covariance() + 1e-12 * np.eye(self.training), lower=True)
        return ((mix @ field) ** 2).sum(axis=2), log_weight


def _ranked(cells: Float[np.ndarray, "... cell"], rank: float) -> Float[np.ndarray, "..."]:
    place = max(0, int(np.ceil(rank * cells.shape[-1])) - 1)
    return np.partition(cells, place, axis=-1)[..., place]
