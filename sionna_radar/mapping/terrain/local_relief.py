"""Where a terrain is rougher than elsewhere: the local amplitude of its short waves, learned from scattered heights.

Real ground is not stationary: gullies, banks and slip faces stand in calm fields. One covariance for all of it states
calm ground too badly and broken ground far too well. Here a terrain of the covariance C is divided into long waves and
short ones, the latter times an amplitude a(x) that varies from place to place. The covariance of two heights is

    C_long(x - y) + a(x) a(y) C_short(x - y),

C_long being C of heights averaged over Gaussians, and C_short the rest of C (Paciorek and Schervish 2006 discuss such
models). Long waves, which the heights know whatever their prior, stay as they are.

Around each node the nearest heights, freed of a plane, have the covariance a^2 C_short + C_long + N, N being their
noise. In the basis that diagonalises both terms the likelihood of each amplitude is a sum over independent numbers. The
logarithm of a^2 has a normal prior over all nodes, about zero, whose width is the likeliest one (empirical Bayes): over
stationary ground it is small, and all amplitudes are one. The mean of a^2 is used, so that what a few heights cannot
tell widens the uncertainty.

One covariance serves all directions. Where walls run along the scan lines, echoes show fewer steps along a line than
stand between lines. So heights of a line are predicted from those of other lines (cross-validation): where they are off
by more than is stated, all standard deviations are larger by as much.

Waves that footprints average away are not told at all, and a window that stands out for another reason would make them
huge. So a^2 is at most that at which short waves, not averaged, have the power of all that was measured above a plane,
or one.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import comb

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import eigh, eigvalsh
from scipy.spatial import KDTree

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.numerics import log_sum_exp, spread_indices
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import in_threads, parts
from sionna_radar.mapping.options import SMOOTH
from sionna_radar.mapping.terrain.covariance import (
    MIN_NOISE_M,
    Covariance,
    CovarianceTable,
    FittedCovariance,
    Measured,
    decorrelated,
    repeated,
)

# Short waves are those of 1 - (1 - g)^ORDER, g being the Gaussian: of the long waves of smooth hills next to nothing. A
# window, freed of a plane, sees waves as short as its diameter: these are divided in halves by power.
ORDER = 3
CUT_OF_SPACING = float(np.sqrt(-np.log(1 - 0.5 ** (1 / ORDER))) / np.pi)
# Values of log a^2, and the widths of their prior. The width has a half-normal prior of the standard deviation 1
# (Gelman 2006): over ground that does not tell it is small.
LOG_SQUARES = np.arange(-8.0, 8.01, 0.25)
PRIOR_WIDTHS = np.array([0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8])
# Windows whose relief stands out by this many standard deviations of its logarithm are no part of the terrain.
OUTSTANDING = 3.0
# Heights that are predicted from other scan lines; fewest heights of those, and how many times its usual length a gap
# between the pulses of a window is, where another line begins.
HELD_OUT, MIN_OTHERS, LINE_GAP = 200, 12, 8
# Standard deviation of a scatter that is the median of n deviations, times sqrt(n) (Rousseeuw and Croux 1993), and how
# many of them are no chance: one tile in 160 of ground as the covariance says.
MEDIAN_SIGMA, SURE = 1.17, 2.5
# Entries of tables of covariances, and how many spreads of footprints they are made for.
TABLE, SPREADS = 1600, 16
# Of the variance: tables of covariances are interpolated.
JITTER = 1e-6


# 1 - (1 - g)^ORDER as a sum of powers of g, each a Gaussian so many times wider.
LONG = tuple((float(np.sqrt(k)), float(-((-1) ** k) * comb(ORDER, k))) for k in range(1, ORDER + 1))


@dataclass(frozen=True)
class LocalRelief:
    """The amplitude a(x) of a terrain's short waves.

    west_m, south_m, spacing_m: of the nodes.
    log_amplitude: logarithm of the amplitude at the nodes: bilinear between them, constant beyond.
    misfit: how many times larger than stated the errors are of heights predicted from other scan lines, at least one.
    """

    west_m: float
    south_m: float
    spacing_m: float
    log_amplitude: Float[np.ndarray, "row column"]
    misfit: float = 1.0

    @property
    def cut_m(self) -> float:
        """Standard deviation of the Gaussian that averages heights to long waves."""
        return CUT_OF_SPACING * self.spacing_m

    def divided(
        self, covariance: Covariance, farthest_m: float, spread_m: float, entries: int
    ) -> tuple[CovarianceTable, CovarianceTable]:
        """Return tables of the covariances of long waves and of short ones; see `Covariance.table`."""
        every = covariance.table(farthest_m, spread_m, entries)
        long = np.zeros(entries)
        for wider, share in LONG:
            averaged = covariance.table(farthest_m, float(np.hypot(spread_m, wider * self.cut_m)), entries)
            long += share * averaged.value_m2
        return CovarianceTable(every.step_m, long), CovarianceTable(every.step_m, every.value_m2 - long)

    def long_share(self, wavenumber: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the share of each wave's power, rad/m, that counts as long."""
        return 1 - (1 - np.exp(-((wavenumber * self.cut_m) ** 2))) ** ORDER

    def at(self, place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return the amplitude at horizontal positions."""
        return np.exp(self._field.at(*place_m.T))

    def on(self, grid: Grid) -> Float[np.ndarray, "row column"]:
        """Return the amplitude in the cells of a grid."""
        return self.at(grid.centres_m).reshape(grid.shape)

    @cached_property
    def _field(self) -> Heightfield:
        rows, columns = self.log_amplitude.shape
        grid = Grid(west_m=self.west_m, south_m=self.south_m, spacing_m=self.spacing_m, columns=columns, rows=rows)
        return Heightfield(grid=grid, height_m=self.log_amplitude)


UNIFORM = LocalRelief(0.0, 0.0, 1.0, np.zeros((2, 2)))


@dataclass(frozen=True)
class Windows:
    """Nodes over an area, and the heights around each of them that are looked at together."""

    west_m: float
    south_m: float
    spacing_m: float
    shape: tuple[int, int]
    member: Int[np.ndarray, "node member"]

    @classmethod
    def of(cls, measured: Measured, heights: int) -> "Windows | None":
        """Return the windows of some heights; None if these are too few for two."""
        kept = decorrelated(measured)
        if len(kept) < 2 * heights:
            return None
        place = measured.place_m[kept]
        tree, low = KDTree(place), place.min(axis=0)
        spacing = float(np.median(tree.query(place, k=heights)[0][:, -1]))
        columns, rows = (np.maximum(np.ceil(np.ptp(place, axis=0) / spacing).astype(int), 1) + 1).tolist()
        x, y = np.meshgrid(low[0] + spacing * np.arange(columns), low[1] + spacing * np.arange(rows))
        near = tree.query(np.column_stack([x.ravel(), y.ravel()]), k=heights)[1]
        return cls(float(low[0]), float(low[1]), spacing, (rows, columns), kept[near])

    def relief(self, measured: Measured, fitted: FittedCovariance) -> LocalRelief:
        """Return the local amplitudes of a terrain's short waves."""
        found = LocalRelief(self.west_m, self.south_m, self.spacing_m, np.zeros(self.shape))
        tables = DividedTables.of(measured, self.member, fitted.covariance, found)

        def some(low: int, high: int) -> Float[np.ndarray, "node value"]:
            return np.array([_log_likelihood(measured, own, tables, fitted) for own in self.member[low:high]])

        likelihood = np.concatenate(list(in_threads(some, parts(len(self.member), 8))))
        overlap = self.member.size / len(np.unique(self.member))
        mean_square = _posterior_mean(likelihood, overlap)
        log_amplitude = 0.5 * np.log(mean_square).reshape(self.shape)
        learned = replace(found, log_amplitude=log_amplitude)
        return replace(learned, misfit=self.misfit(measured, fitted, learned))

    def misfit(self, measured: Measured, fitted: FittedCovariance, relief: LocalRelief) -> float:
        """Return the robust scatter of heights about predictions from other scan lines, in their standard deviations.

        One unless it is surely more.
        """
        kept = decorrelated(measured)
        place = measured.place_m[kept]
        held_out = place[spread_indices(HELD_OUT, len(kept))]
        near = kept[KDTree(place).query(held_out, k=self.member.shape[1])[1]]
        tables = DividedTables.of(measured, near, fitted.covariance, relief)
        off = [each for own in near if (each := _off_other_lines(measured, own, fitted, relief, tables)) is not None]
        if not off:
            return 1.0
        scatter = 1.4826 * float(np.median(np.abs(off)))
        return scatter if scatter > 1 + SURE * MEDIAN_SIGMA / np.sqrt(len(off)) else 1.0


@dataclass(frozen=True)
class DividedTables:
    """Covariances of long waves and of short ones, averaged over footprints of several spreads.

    spread_m: of the footprints, increasing; between them covariances are interpolated.
    step_m, long_m2, short_m2: see `CovarianceTable`.
    unaveraged: the covariance of short waves at places.
    """

    spread_m: Float[np.ndarray, " spread"]
    step_m: float
    long_m2: Float[np.ndarray, "spread entry"]
    short_m2: Float[np.ndarray, "spread entry"]
    unaveraged: CovarianceTable

    @classmethod
    def of(
        cls, measured: Measured, member: Int[np.ndarray, "window member"], covariance: Covariance, relief: LocalRelief
    ) -> "DividedTables":
        """Return tables for windows of some heights."""
        place = measured.place_m[member]
        away = place - place.mean(axis=1, keepdims=True)
        farthest = 2 * float(np.linalg.norm(away, axis=2).max()) + 1.0
        spread = np.unique(np.quantile(measured.spread_m[member], np.linspace(0.0, 1.0, SPREADS)))
        pairs = [relief.divided(covariance, farthest, float(each), TABLE) for each in spread]
        long, short = (np.array([table.value_m2 for table in tables]) for tables in zip(*pairs, strict=True))
        unaveraged = relief.divided(covariance, farthest, 0.0, TABLE)[1]
        return cls(spread, unaveraged.step_m, long, short, unaveraged)

    def between(
        self, place_m: Float[np.ndarray, "n 2"], spread_m: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]]:
        """Return the covariances of long waves and of short ones between places, for the median of their spreads."""
        at = float(np.interp(np.median(spread_m), self.spread_m, np.arange(len(self.spread_m))))
        low, high = int(at), min(int(at) + 1, len(self.spread_m) - 1)
        values = (own[low] + (at - low) * (own[high] - own[low]) for own in (self.long_m2, self.short_m2))
        long, short = (CovarianceTable(self.step_m, each).between(place_m, place_m) for each in values)
        return long, short


def calm(measured: Measured, window_heights: int = SMOOTH.window_heights) -> Bool[np.ndarray, " n"]:
    """Return a mask of the heights where the relief does not stand out from the terrain: away from poles and walls."""
    windows = Windows.of(measured, window_heights)
    if windows is None:
        return np.ones(len(measured.height_m), dtype=bool)
    log = np.log([_rms_above_plane(measured, own) for own in windows.member])
    scatter = 1.4826 * float(np.median(np.abs(log - np.median(log))))
    standing = windows.member[log > np.median(log) + OUTSTANDING * scatter]
    return ~np.isin(np.arange(len(measured.height_m)), standing)


def local_relief(
    measured: Measured, fitted: FittedCovariance, window_heights: int = SMOOTH.window_heights
) -> LocalRelief | None:
    """Return the local amplitude of a terrain's short waves; None with too few heights to tell.

    measured: heights above a trend.
    fitted: the covariance that the amplitude is relative to.
    window_heights: neighbouring heights that decide about a place.
    """
    windows = Windows.of(measured, window_heights)
    return None if windows is None else windows.relief(measured, fitted)


def _rms_above_plane(measured: Measured, own: Int[np.ndarray, " member"]) -> float:
    """Return the RMS of neighbouring heights above their plane."""
    contrast = _contrast(measured.place_m[own] - measured.place_m[own].mean(axis=0))
    return float(np.linalg.norm(contrast.T @ measured.height_m[own]) / np.sqrt(len(own)))


def _contrast(away_m: Float[np.ndarray, "member 2"]) -> Float[np.ndarray, "member contrast"]:
    """Return an orthonormal basis of what heights at some places are above their plane."""
    return np.linalg.qr(np.column_stack([np.ones(len(away_m)), away_m]), mode="complete")[0][:, 3:]


def _off_other_lines(
    measured: Measured,
    own: Int[np.ndarray, " member"],
    fitted: FittedCovariance,
    relief: LocalRelief,
    tables: DividedTables,
) -> float | None:
    """Return the error of predicting the first of neighbouring heights from other scan lines, over its sigma.

    The prediction is by universal kriging about a plane (Chiles and Delfiner 2012, section 3.4); None with too few of
    other lines, or without lines before and after its own: beside them errors of all heights are those of one slope.
    """
    order = np.sort(measured.order[own])
    ends = order[:-1][np.diff(order) > LINE_GAP * np.median(np.diff(order))]
    line = np.searchsorted(ends, measured.order[own])
    rows = np.concatenate([own[:1], own[line != line[0]]])
    if len(rows) <= MIN_OTHERS or not line.min() < line[0] < line.max():
        return None
    place = np.ascontiguousarray(measured.place_m[rows])
    sigma = np.maximum(measured.sigma_m[rows], MIN_NOISE_M)
    noise = np.outer(sigma, sigma) * repeated(measured.order[rows], measured.reach[rows])
    long, short = tables.between(place, measured.spread_m[rows])
    amplitude = relief.at(place)
    total = long + np.outer(amplitude, amplitude) * short + fitted.noise_factor * noise
    total += JITTER * fitted.covariance.variance_m2 * np.eye(len(rows))
    # With the inverse Q of the covariance of what no plane explains, the error of leaving out i is (Q h)_i / Q_ii, and
    # its variance 1 / Q_ii.
    contrast = _contrast(place - place[0])
    weight = np.linalg.solve(contrast.T @ total @ contrast, contrast[0])
    return float(weight @ (contrast.T @ measured.height_m[rows]) / np.sqrt(weight @ contrast[0]))


def _log_likelihood(
    measured: Measured, own: Int[np.ndarray, " member"], tables: DividedTables, fitted: FittedCovariance
) -> Float[np.ndarray, " value"]:
    """Return the restricted log-likelihood of each of `LOG_SQUARES`, given some neighbouring heights.

    It ends where short waves, not averaged, would have more power above a plane than was measured.
    """
    place = np.ascontiguousarray(measured.place_m[own])
    contrast = _contrast(place - place.mean(axis=0))
    long, short = tables.between(place, measured.spread_m[own])
    sigma = np.maximum(measured.sigma_m[own], MIN_NOISE_M)
    noise = np.outer(sigma, sigma) * repeated(measured.order[own], measured.reach[own])
    rest = long + fitted.noise_factor * noise + JITTER * fitted.covariance.variance_m2 * np.eye(len(own))
    share, vector = _modes(contrast.T @ short @ contrast, contrast.T @ rest @ contrast)
    above = contrast.T @ measured.height_m[own]
    square = (vector.T @ above) ** 2
    total = 1 + np.exp(LOG_SQUARES)[:, None] * np.maximum(share, 0.0)
    result: Float[np.ndarray, " value"] = -0.5 * np.sum(np.log(total) + square / total, axis=1)
    largest = np.sum(above**2) / np.sum(contrast * (tables.unaveraged.between(place, place) @ contrast))
    result[max(np.log(largest), 0.0) < LOG_SQUARES] = -np.inf
    return result


def _modes(
    short: Float[np.ndarray, "n n"], rest: Float[np.ndarray, "n n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n n"]]:
    """Return the modes in which two covariances are both diagonal, the second one, and the first relative to it.

    Rounding of tables may leave the second one slightly indefinite: it is raised until it is definite.
    """
    try:
        share, vector = eigh(short, rest, check_finite=False)
    except np.linalg.LinAlgError:
        values = eigvalsh(rest, check_finite=False)
        lift = 2 * abs(values[0]) + len(rest) * np.finfo(float).eps * abs(values[-1])
        share, vector = eigh(short, rest + lift * np.eye(len(rest)), check_finite=False)
    return share, vector


def _posterior_mean(log_likelihood: Float[np.ndarray, "node value"], overlap: float) -> Float[np.ndarray, " node"]:
    """Return the mean of a^2 at each node.

    overlap: windows that each height is in, about: so many times too much the sum over all nodes seems to tell.
    """
    prior = -((LOG_SQUARES / PRIOR_WIDTHS[:, None]) ** 2) / 2
    prior -= log_sum_exp(prior, axis=1, keepdims=True)
    told = log_sum_exp(log_likelihood[:, None] + prior, axis=2)
    posterior = log_likelihood + prior[np.argmax(told.sum(axis=0) / overlap - PRIOR_WIDTHS**2 / 2)]
    return np.exp(log_sum_exp(posterior + LOG_SQUARES, axis=1) - log_sum_exp(posterior, axis=1))
