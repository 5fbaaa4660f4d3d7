"""Local relief of non-stationary terrain: the amplitude of its short waves, estimated from scattered heights.

Real ground is not stationary: gullies, banks and slip faces stand in calm fields. A single covariance overstates the
uncertainty of calm ground and understates that of broken ground. Here a terrain of the covariance C is divided into
long waves and short ones, the latter times an amplitude a(x) that varies from place to place. The covariance of two
heights is

    C_long(x - y) + a(x) a(y) C_short(x - y),

C_long being C of heights averaged over Gaussians, and C_short the rest of C (Paciorek and Schervish 2006 discuss such
models). Long waves, which the heights know whatever their prior, stay as they are.

Around each node the nearest heights, freed of a plane, have the covariance a^2 C_short + C_long + N, N being their
noise. In the basis that diagonalises both terms the likelihood of each amplitude is a sum over independent numbers. The
logarithm of a^2 has a normal prior over all nodes, about zero, whose width is the likeliest one (empirical Bayes): over
stationary ground it is none, and all amplitudes are one. The mean of a^2 is used, so that what a few heights cannot
tell widens the uncertainty.

One covariance serves all directions. Where walls run along the scan lines, echoes show fewer steps along a line than
stand between lines. So heights of a line are predicted from those of other lines (cross-validation): where they are off
by more than is stated, all standard deviations are larger by as much.

Waves that footprints average away are not observable, and a window that stands out for another reason would make them
huge. So a^2 is at most that at which short waves, not averaged, have the power of all that was measured above a plane,
or one.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import comb

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.numerics import MAD_SIGMA, log_sum_exp
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.foundation.threads import chunks_of_bytes, cores_of_thread, in_threads
from sionna_radar.inference.terrain.covariance import (
    Covariance,
    CovarianceTable,
    FittedCovariance,
    covariances_between,
    knots,
    tabulated,
)
from sionna_radar.inference.terrain.covariance_fit import MIN_NOISE_M, Measured, decorrelated, repeated

# Short waves are those of 1 - (1 - g)^ORDER, g being the Gaussian: of the long waves of smooth hills next to nothing. A
# window, freed of a plane, sees waves as short as its diameter: these are divided in halves by power.
ORDER = 3
CUT_OF_SPACING = float(np.sqrt(-np.log(1 - 0.5 ** (1 / ORDER))) / np.pi)
# Values of log a^2, and the widths of their prior. The width has a half-normal prior of the standard deviation 1
# (Gelman 2006): over ground that does not constrain the width it is zero.
LOG_SQUARES = np.arange(-8.0, 8.01, 0.25)
PRIOR_WIDTHS = np.array([0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8])
# Windows whose relief exceeds the median by this many standard deviations of its logarithm are not terrain.
OUTLIER_SIGMAS = 3.0
# Number of heights that are predicted from other scan lines; fewest heights of those, and the gap between the pulses of
# a window, in usual gaps, at which another line begins.
HELD_OUT, MIN_OTHERS, LINE_GAP = 200, 12, 8
# Standard deviation of a scatter that is the median of n deviations, times sqrt(n) (Rousseeuw and Croux 1993). Over
# `hills`, in 46 surveys, that of the scatter is 1.05 to 1.15 times that of independent deviations.
MEDIAN_SIGMA = 1.17
# Excess scatter, in such standard deviations, that counts as significant: a false alarm in one tile of 10,000 (one in
# 160 at 2.5).
MIN_EVIDENCE_SIGMAS = 3.7
# Number of footprint spreads for which covariance tables are made.
SPREADS = 16
# Of the variance: tables of covariances are interpolated.
JITTER = 1e-6


# 1 - (1 - g)^ORDER as a sum of powers of g, each a Gaussian so many times wider.
LONG = tuple((float(np.sqrt(k)), float(-((-1) ** k) * comb(ORDER, k))) for k in range(1, ORDER + 1))


@dataclass(frozen=True)
class LocalRelief:
    """The amplitude a(x) of a terrain's short waves.

    west_m, south_m, spacing_m: of the nodes.
    log_amplitude: logarithm of the amplitude at the nodes: bilinear between them, constant beyond.
    """

    west_m: float
    south_m: float
    spacing_m: float
    log_amplitude: Float[np.ndarray, "row column"]

    @property
    def cut_m(self) -> float:
        """Standard deviation of the Gaussian that averages heights to long waves."""
        return CUT_OF_SPACING * self.spacing_m

    def divided(
        self, covariance: Covariance, farthest_m: float, spread_m: float
    ) -> tuple[CovarianceTable, CovarianceTable]:
        """Return tables of the covariances of long waves and of short ones; see `Covariance.table`."""
        long, short = self.covariances(covariance, knots(farthest_m), spread_m)
        return CovarianceTable.of(long, farthest_m), CovarianceTable.of(short, farthest_m)

    def covariances(
        self, covariance: Covariance, distance_m: Float[np.ndarray, " n"], spread_m: float
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return the covariances of long waves and of short ones at distances; see `Covariance.at`."""
        long = np.zeros(len(distance_m))
        for wider, weight in LONG:
            long += weight * covariance.at(distance_m, float(np.hypot(spread_m, wider * self.cut_m)))
        return long, covariance.at(distance_m, spread_m) - long

    def long_fraction(self, wavenumber: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the fraction of the power of each wave (rad/m) that counts as long."""
        return 1 - (1 - np.exp(-((wavenumber * self.cut_m) ** 2))) ** ORDER

    def at(self, place_m: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "..."]:
        """Return the amplitude at horizontal positions."""
        return np.exp(self._field.at(*place_m.reshape(-1, 2).T)).reshape(place_m.shape[:-1])

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
    """Nodes over an area, and the nearest heights around each of them."""

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
        spacing = float(np.median(tree.query(place, k=heights, workers=cores_of_thread())[0][:, -1]))
        columns, rows = (np.maximum(np.ceil(np.ptp(place, axis=0) / spacing).astype(int), 1) + 1).tolist()
        x, y = np.meshgrid(low[0] + spacing * np.arange(columns), low[1] + spacing * np.arange(rows))
        near = tree.query(np.column_stack([x.ravel(), y.ravel()]), k=heights, workers=cores_of_thread())[1]
        return cls(float(low[0]), float(low[1]), spacing, (rows, columns), kept[near])

    def chunks(self) -> list[tuple[int, int]]:
        """Return the bounds of chunks of windows, whose matrices of all pairs are held at once."""
        windows, members = self.member.shape
        return chunks_of_bytes(windows, 8 * members**2)

    def relief(self, measured: Measured, fitted: FittedCovariance) -> LocalRelief | None:
        """Return the local amplitudes of a terrain's short waves; None where they are likeliest the same."""
        uniform = LocalRelief(self.west_m, self.south_m, self.spacing_m, np.zeros(self.shape))
        tables = DividedTables.of(measured, self.member, fitted.covariance, uniform)

        def some(low: int, high: int) -> Float[np.ndarray, "node value"]:
            return _log_likelihood(measured, self.member[low:high], tables, fitted)

        likelihood = np.concatenate(list(in_threads(some, self.chunks())))
        overlap = self.member.size / len(np.unique(self.member))
        mean_square = _posterior_mean(likelihood, overlap)
        if mean_square is None:
            return None
        return replace(uniform, log_amplitude=0.5 * np.log(mean_square).reshape(self.shape))


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
        at_knots = np.array([relief.covariances(covariance, knots(farthest), float(each)) for each in spread])
        long, short = tabulated(at_knots.swapaxes(0, 1), farthest)
        unaveraged = relief.divided(covariance, farthest, 0.0)[1]
        return cls(spread, unaveraged.step_m, long, short, unaveraged)

    def between(
        self, place_m: Float[np.ndarray, "window n 2"], spread_m: Float[np.ndarray, " window"]
    ) -> tuple[Float[np.ndarray, "window n n"], Float[np.ndarray, "window n n"]]:
        """Return the covariances of long waves and of short ones between the places of each window."""
        at = np.interp(spread_m, self.spread_m, np.arange(len(self.spread_m)))
        low = at.astype(int)
        high, fraction = np.minimum(low + 1, len(self.spread_m) - 1), (at - low)[:, None]
        values = (
            values_m2[low] + fraction * (values_m2[high] - values_m2[low])
            for values_m2 in (self.long_m2, self.short_m2)
        )
        long, short = (covariances_between(place_m, place_m, self.step_m, each) for each in values)
        return long, short


def low_relief_mask(measured: Measured, window_heights: int) -> Bool[np.ndarray, " n"]:
    """Return a mask of the heights whose surroundings have typical relief: away from poles and walls."""
    windows = Windows.of(measured, window_heights)
    if windows is None:
        return np.ones(len(measured.height_m), dtype=bool)
    bounds = windows.chunks()
    rms = in_threads(lambda low, high: _rms_above_plane(measured, windows.member[low:high]), bounds)
    log = np.log(np.concatenate(list(rms)))
    scatter = MAD_SIGMA * float(np.median(np.abs(log - np.median(log))))
    standing = windows.member[log > np.median(log) + OUTLIER_SIGMAS * scatter]
    return ~np.isin(np.arange(len(measured.height_m)), standing)


def consistent_mask(measured: Measured, window_heights: int, sigmas: float) -> Bool[np.ndarray, " n"]:
    """Return a mask without the heights that stand alone, as of false echoes.

    Those are farther from the plane of their surroundings than so many standard deviations, which are those of the
    median distance, in all windows that hold them.
    """
    windows = Windows.of(measured, window_heights)
    if windows is None:
        return np.ones(len(measured.height_m), dtype=bool)

    def off(low: int, high: int) -> Bool[np.ndarray, "window n"]:
        member = windows.member[low:high]
        contrast = _contrast(measured.place_m[member])
        away = np.abs(np.einsum("wnc,wc->wn", contrast, _plane_free(contrast, measured.height_m[member])))
        return away > sigmas * MAD_SIGMA * np.median(away, axis=1, keepdims=True)

    alone = np.concatenate(list(in_threads(off, windows.chunks())))
    held, out = (
        np.bincount(rows, minlength=len(measured.height_m)) for rows in (windows.member.ravel(), windows.member[alone])
    )
    return (held == 0) | (out < held)


def local_relief(measured: Measured, fitted: FittedCovariance, window_heights: int) -> LocalRelief | None:
    """Return the local amplitude of a terrain's short waves; None where it is one, or with too few heights.

    measured: heights above a trend.
    fitted: the covariance that the amplitude is relative to.
    window_heights: number of neighbouring heights from which the relief of a place is estimated.
    """
    windows = Windows.of(measured, window_heights)
    return None if windows is None else windows.relief(measured, fitted)


def misfit_between_lines(
    measured: Measured,
    fitted: FittedCovariance,
    relief: LocalRelief | None,
    window_heights: int,
) -> float:
    """Return the robust scatter of heights about predictions from other scan lines, in their standard deviations.

    One unless it is significantly more, and where there were too few heights for a `local_relief`.
    """
    kept, relief = decorrelated(measured), relief or UNIFORM
    if len(kept) < 2 * window_heights:
        return 1.0
    place = measured.place_m[kept]
    held_out = place[spread_indices(HELD_OUT, len(kept))]
    near = kept[KDTree(place).query(held_out, k=window_heights)[1]]
    off = _cross_line_errors(
        measured, near, fitted, relief, DividedTables.of(measured, near, fitted.covariance, relief)
    )
    if len(off) == 0:
        return 1.0
    scatter = MAD_SIGMA * float(np.median(np.abs(off)))
    return scatter if scatter > 1 + MIN_EVIDENCE_SIGMAS * MEDIAN_SIGMA / np.sqrt(len(off)) else 1.0


def _rms_above_plane(measured: Measured, member: Int[np.ndarray, "window n"]) -> Float[np.ndarray, " window"]:
    """Return the RMS of the heights of each window above their plane."""
    above = _plane_free(_contrast(measured.place_m[member]), measured.height_m[member])
    return np.linalg.norm(above, axis=1) / np.sqrt(member.shape[1])


def _contrast(
    place_m: Float[np.ndarray, "window n 2"], used: Bool[np.ndarray, "window n"] | bool = True
) -> Float[np.ndarray, "window n contrast"]:
    """Return an orthonormal basis, for each window, of what heights are above the plane of those that are used."""
    away = place_m - place_m.mean(axis=1, keepdims=True)
    plane = np.concatenate([np.ones((*away.shape[:2], 1)), away], axis=2) * np.expand_dims(used, -1)
    return np.linalg.qr(plane, mode="complete")[0][:, :, 3:]


def _plane_free(
    contrast: Float[np.ndarray, "window n contrast"], height_m: Float[np.ndarray, "window n"]
) -> Float[np.ndarray, "window contrast"]:
    """Return the contrasts of the heights of each window."""
    return (height_m[:, None] @ contrast)[:, 0]


def _noise_m2(measured: Measured, member: Int[np.ndarray, "window n"]) -> Float[np.ndarray, "window n n"]:
    """Return the covariance of the noise of the heights of each window."""
    sigma = np.maximum(measured.sigma_m[member], MIN_NOISE_M)
    return sigma[:, :, None] * sigma[:, None] * repeated(measured.order[member], measured.reach[member])


def _cross_line_errors(
    measured: Measured,
    member: Int[np.ndarray, "window n"],
    fitted: FittedCovariance,
    relief: LocalRelief,
    tables: DividedTables,
) -> Float[np.ndarray, " predicted"]:
    """Return the errors of predicting the first height of windows from those of other scan lines, over their sigmas.

    The prediction is by universal kriging about a plane (Chiles and Delfiner 2012, section 3.4). Windows with too few
    heights of other lines, or without lines before and after that of the first, are left out: beside them errors of
    all heights are those of one slope.
    """
    line = _scan_line(measured.order[member])
    used = line != line[:, :1]
    used[:, 0] = True
    usable = (used.sum(axis=1) > MIN_OTHERS) & (line.min(axis=1) < line[:, 0]) & (line[:, 0] < line.max(axis=1))
    member, used = member[usable], used[usable]
    place, spread = measured.place_m[member], np.where(used, measured.spread_m[member], np.nan)
    long, short = tables.between(place, np.nanmedian(spread, axis=1))
    amplitude = relief.at(place)
    total = long + amplitude[:, :, None] * amplitude[:, None] * short
    total += fitted.noise_factor * _noise_m2(measured, member)
    # Heights that are not used are zeros of their own, which no plane reaches.
    total *= used[:, :, None] & used[:, None]
    diagonal = np.arange(member.shape[1])
    total[:, diagonal, diagonal] += np.where(used, JITTER, 1.0) * fitted.covariance.variance_m2
    # With the inverse Q of the covariance of what no plane explains, the error of leaving out i is (Q h)_i / Q_ii, and
    # its variance 1 / Q_ii.
    contrast = _contrast(place, used)
    first = contrast[:, 0]
    weight = np.linalg.solve(contrast.transpose(0, 2, 1) @ total @ contrast, first[:, :, None])[:, :, 0]
    above = _plane_free(contrast, measured.height_m[member] * used)
    information = np.sum(weight * first, axis=1)
    # Rounding may leave windows of nearly equal heights without any.
    told = information > 0
    return np.sum(weight * above, axis=1)[told] / np.sqrt(information[told])


def _scan_line(order: Float[np.ndarray, "window n"]) -> Int[np.ndarray, "window n"]:
    """Return the scan line, counted within each window, that each of its pulses is of."""
    rank = np.argsort(order, axis=1)
    step = np.diff(np.take_along_axis(order, rank, axis=1), axis=1)
    begins = step > LINE_GAP * np.median(step, axis=1, keepdims=True)
    line = np.zeros(order.shape, dtype=int)
    np.put_along_axis(line, rank[:, 1:], np.cumsum(begins, axis=1), axis=1)
    return line


def _log_likelihood(
    measured: Measured, member: Int[np.ndarray, "window n"], tables: DividedTables, fitted: FittedCovariance
) -> Float[np.ndarray, "window value"]:
    """Return the restricted log-likelihood of each of `LOG_SQUARES`, given the heights of each window.

    It ends where short waves, not averaged, would have more power above a plane than was measured.
    """
    place = measured.place_m[member]
    contrast = _contrast(place)
    long, short = tables.between(place, np.median(measured.spread_m[member], axis=1))
    rest = long + fitted.noise_factor * _noise_m2(measured, member)
    diagonal = np.arange(member.shape[1])
    rest[:, diagonal, diagonal] += JITTER * fitted.covariance.variance_m2
    back = contrast.transpose(0, 2, 1)
    eigenvalue, vector = _modes(back @ short @ contrast, back @ rest @ contrast)
    above = _plane_free(contrast, measured.height_m[member])
    square = _plane_free(vector, above) ** 2
    total = 1 + np.exp(LOG_SQUARES)[:, None] * np.maximum(eigenvalue, 0.0)[:, None]
    result = -0.5 * np.sum(np.log(total) + square[:, None] / total, axis=2)
    unaveraged = covariances_between(place, place, tables.unaveraged.step_m, tables.unaveraged.value_m2[None])
    largest = np.sum(above**2, axis=1) / np.sum(contrast * (unaveraged @ contrast), axis=(1, 2))
    result[np.maximum(np.log(largest), 0.0)[:, None] < LOG_SQUARES] = -np.inf
    return result


def _modes(
    short: Float[np.ndarray, "window n n"], rest: Float[np.ndarray, "window n n"]
) -> tuple[Float[np.ndarray, "window n"], Float[np.ndarray, "window n n"]]:
    """Return the modes in which two covariances are both diagonal, the second one, and the first relative to it.

    Rounding of tables may leave the second one slightly indefinite: it is raised until it is definite.
    """
    try:
        root = np.linalg.cholesky(rest)
    except np.linalg.LinAlgError:
        values = np.linalg.eigvalsh(rest)
        rounding = rest.shape[1] * np.finfo(float).eps * np.abs(values[:, -1])
        lift = np.where(values[:, 0] < rounding, 2 * np.abs(values[:, 0]) + rounding, 0.0)
        root = np.linalg.cholesky(rest + lift[:, None, None] * np.eye(rest.shape[1]))
    inverse = np.linalg.inv(root)
    eigenvalue, turn = np.linalg.eigh(inverse @ short @ inverse.transpose(0, 2, 1))
    return eigenvalue, inverse.transpose(0, 2, 1) @ turn


def _posterior_mean(
    log_likelihood: Float[np.ndarray, "node value"], overlap: float
) -> Float[np.ndarray, " node"] | None:
    """Return the mean of a^2 at each node; None where no width of its prior is likelier than none, so that it is one.

    overlap: windows that each height is in, about: the sum over all nodes overcounts the information by this factor.
    """
    prior = -((LOG_SQUARES / PRIOR_WIDTHS[:, None]) ** 2) / 2
    prior -= log_sum_exp(prior, axis=1, keepdims=True)
    by_width = np.column_stack([log_sum_exp(log_likelihood + each, axis=1) for each in prior])
    evidence = by_width.sum(axis=0) / overlap - PRIOR_WIDTHS**2 / 2
    if log_likelihood[:, LOG_SQUARES == 0].sum() / overlap >= evidence.max():
        return None
    posterior = log_likelihood + prior[np.argmax(evidence)]
    return np.exp(log_sum_exp(posterior + LOG_SQUARES, axis=1) - log_sum_exp(posterior, axis=1))
