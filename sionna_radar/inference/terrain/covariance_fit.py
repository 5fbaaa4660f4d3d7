"""Covariance of a terrain, fitted to scattered heights by maximum likelihood.

A measured height is the mean of the terrain over a beam's footprint plus noise: so a wide beam does not pass for smooth
terrain. The noise is known, with its correlation between neighbouring pulses, up to a factor; it is fitted with a prior
around one, so that it absorbs errors of the noise model but does not trade places with terrain. Microrelief, which the
echoes hardly constrain, is stated.

A plane that was fitted to the heights and taken out has taken some of their long waves with it, most of them where a
flight is short. The likelihood is then that of the contrasts that no plane changes (residual maximum likelihood:
Patterson and Thompson 1971, "Recovery of inter-block information when block sizes are unequal"; Harville 1974).

Over ground that is as even as a plane the likeliest variance is none, and a map would leave out all that rises from the
plane. So the likelihood is multiplied by the standard deviation of the landforms: where it is likeliest at zero, the
estimate is then about one standard error, and elsewhere it moves by one over the number of independent heights (Chung
et al. 2013, "A nondegenerate penalized likelihood estimator for variance parameters in multilevel models",
Psychometrika 78, 685-709).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist

from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.linear_algebra import inverse_and_solution
from sionna_radar.foundation.threads import in_threads
from sionna_radar.inference.terrain.covariance import Covariance, CovarianceTable, FittedCovariance, entry_of

# Bounds of the smoothness; beyond them terrain is as good as Gaussian.
ROUGHEST, SMOOTHEST = 0.3, 12.0
# Likelihoods are summed over groups of near neighbours: a large survey is too much to treat at once.
GROUP, GROUPS = 260, 3
MIN_NOISE_M = 1e-3
# Fraction of the noise variance that is uncorrelated: receiver noise, and scatterers that enter the beam.
UNCORRELATED_NOISE_FRACTION = 0.03
# Prior standard deviation of the logarithm of the noise factor: over simulated speckle, echoes of 1 to 8 deg scatter
# 0.95 to 1.1 times as the noise model predicts. A looser prior explains rough ground as noise: over real ground 0.1
# assigned to noise half of what 0.05 calls rough.
NOISE_FACTOR_SPREAD = 0.05
# Prior against smooth terrain, nepers per unit of log(1 + smoothness): below the footprint, echoes distinguish smooth
# from rough terrain only by the tails of the beam's pattern, which are not quite Gaussian, and a map that takes rough
# ground for smooth is overconfident.
PRIOR_NEPERS_SMOOTHNESS = 3.0
TABLE = 400
ITERATIONS, STEP = 30, 1e-3
# Initial smoothness of the search.
FIRST_SMOOTHNESS = 1.0
# Landforms have slopes: a Matern field is mean-square differentiable from a smoothness of 1 on, and what is rougher is
# microrelief. Nor is real ground smoother than about 1.6: second differences of what lidars measured in twelve places
# of four landscapes grow as the 0.8th to 1.7th power of the distance, from 1 to 16 m (`docs/checks/uncertainty.md`).
# Long waves decide a fit, and a larger smoothness that suits them would leave out the short ones.
DIFFERENTIABLE, SMOOTHEST_LANDFORMS = 1.0, 1.6


@dataclass(frozen=True, kw_only=True)
class Measured(Columns):
    """Scattered height measurements for fitting a covariance.

    place_m, height_m: horizontal positions, and heights above a trend.
    sigma_m: standard deviations of their noise.
    spread_m: standard deviations, along an axis, of the Gaussian footprints over which they are means.
    order, reach: position in the sequence of pulses, and over how many of them speckle repeats: the errors of two
        heights n pulses apart have the correlation exp(-n^2 / reach^2); 0 for none.
    microrelief_m: what is usual on such ground; see `Covariance`.
    detrended: whether the trend was fitted to them.
    """

    place_m: Float[np.ndarray, "n 2"]
    height_m: Float[np.ndarray, " n"]
    sigma_m: Float[np.ndarray, " n"]
    spread_m: Float[np.ndarray, " n"]
    order: Float[np.ndarray, " n"]
    reach: Float[np.ndarray, " n"]
    microrelief_m: float = 0.0
    detrended: bool = False

    @property
    def smoothness_bounds(self) -> tuple[float, float]:
        """Least and largest smoothness of a covariance of the landforms."""
        return (DIFFERENTIABLE, SMOOTHEST_LANDFORMS) if self.microrelief_m > 0 else (ROUGHEST, SMOOTHEST)


def fit_covariance(
    measured: Measured, groups: int = GROUPS, noise_factor_spread: float = NOISE_FACTOR_SPREAD
) -> FittedCovariance:
    """Fit a covariance of the terrain, and the factor on the variance of the noise, to groups of neighbours.

    measured: scattered heights.
    groups: how many groups of them.
    noise_factor_spread: standard deviation of the logarithm of the noise factor, beforehand.
    """
    extent = float(np.ptp(measured.place_m, axis=0).max())
    variance = max(float(np.var(measured.height_m)), MIN_NOISE_M**2)
    near, bounds = neighbours(measured, groups), _search_bounds(measured)
    start = np.log([0.1 * extent, variance, 1.0, FIRST_SMOOTHNESS])
    options = {"maxiter": ITERATIONS, "ftol": 1e-6}
    args = near, measured.microrelief_m, noise_factor_spread
    fit = minimize(_loss, start, args=args, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    length, scale, factor, smoothness = (float(value) for value in np.exp(fit.x))
    return FittedCovariance(Covariance(smoothness, length, scale, measured.microrelief_m), factor)


def _search_bounds(measured: Measured) -> list[tuple[float, float]]:
    """Return bounds of the logarithms of length, variance, noise factor and smoothness.

    The length is at least a footprint's standard deviation: for shorter waves only variance x length^2 is
    identifiable from heights averaged over footprints, and the maximum-likelihood variance is arbitrary.
    """
    extent = float(np.ptp(measured.place_m, axis=0).max())
    variance = max(float(np.var(measured.height_m)), MIN_NOISE_M**2)
    roughest, smoothest = measured.smoothness_bounds
    shortest = min(max(3e-3 * extent, float(np.median(measured.spread_m))), extent)
    return [
        (np.log(shortest), np.log(extent)),
        (np.log(1e-4 * variance), np.log(1e3 * variance)),
        (np.log(0.02), np.log(100.0)),
        (np.log(roughest), np.log(smoothest)),
    ]


def neighbours(measured: Measured, groups: int = GROUPS) -> list["Group"]:
    """Return groups of neighbouring heights; the likelihood is summed over the groups."""
    kept = decorrelated(measured)
    planes = _planes(measured.place_m) if measured.detrended else None
    return [Group.of(measured, kept[rows], planes) for rows in _groups(measured.place_m[kept], groups)]


def decorrelated(measured: Measured) -> Int[np.ndarray, " kept"]:
    """Return the rows of heights with little common speckle.

    Of successive pulses that share most of their speckle only one is kept: the others add little information, and
    errors of the modelled correlation would be taken for rough ground.
    """
    stride = max(1, int(np.median(measured.reach)))
    return np.flatnonzero(measured.order % stride == 0) if stride > 1 else np.arange(len(measured.order))


@dataclass(frozen=True)
class Group:
    """Neighbouring heights, a common footprint, and what does not depend on the covariance that is tried.

    table_m: distances at which a covariance is computed; entry, fraction: for every two heights, the entry below their
        distance, and the fraction of the way to the next; noise_m2: the covariance of their noise. Pairs are those of
        the lower triangle, row by row.
    planes: columns that span the trends of all heights, at these; None where none was fitted.
    """

    height_m: Float[np.ndarray, " n"]
    spread_m: float
    table_m: Float[np.ndarray, " entry"]
    entry: Int[np.ndarray, " pair"]
    fraction: Float[np.ndarray, " pair"]
    noise_m2: Float[np.ndarray, " pair"]
    planes: Float[np.ndarray, "n plane"] | None = None

    @classmethod
    def of(
        cls,
        measured: Measured,
        rows: Int[np.ndarray, " n"],
        planes: Float[np.ndarray, "every plane"] | None = None,
    ) -> "Group":
        """Return the group of some of the measured heights."""
        place = np.ascontiguousarray(measured.place_m[rows])
        table = CovarianceTable.distances(float(pdist(place).max(initial=1e-6)), TABLE)
        lower = np.tril_indices(len(rows))
        entry, fraction = np.empty(len(lower[0]), dtype=np.int32), np.empty(len(lower[0]))
        pairs(place, table[1], TABLE - 1, entry, fraction)
        sigma = np.maximum(measured.sigma_m[rows], MIN_NOISE_M)
        noise = np.outer(sigma, sigma) * repeated(measured.order[rows], measured.reach[rows])
        spread = float(np.median(measured.spread_m[rows]))
        own = None if planes is None else planes[rows]
        return cls(measured.height_m[rows], spread, table, entry, fraction, noise[lower], own)

    def inverted(self, tried: Covariance, noise_factor: float) -> "Inverted":
        """Return the inverse covariance of the heights; LinAlgError where it is not positive."""
        # Its upper triangle is subtracted from, too: as it comes, memory may hold what is no number.
        inverse = np.zeros((len(self.height_m),) * 2)
        value = tried.at(self.table_m, self.spread_m)
        fill(value, self.entry, self.fraction, self.noise_m2, noise_factor, 1e-9 * tried.variance_m2, inverse)
        half, solved = inverse_and_solution(inverse, self.height_m)
        return Inverted(value, inverse, solved, float(self.height_m @ solved / 2 + half))

    def growth(
        self, at: "Inverted", tried: Covariance, noise_factor: float, others: Sequence[Covariance]
    ) -> tuple[Float[np.ndarray, " other"], float, float]:
        """Return derivatives of the negative log-likelihood.

        They are its changes toward each of other covariances, and its derivatives by the logarithms of the landforms'
        variance and of the noise factor.
        """
        by_entry = np.empty(TABLE)
        by_noise = sensitivity(at.inverse, at.solved, self.entry, self.fraction, self.noise_m2, by_entry)
        toward = np.array([by_entry @ (other.at(self.table_m, self.spread_m) - at.value) for other in others])
        landforms = at.value if tried.microrelief_m == 0 else tried.landforms.at(self.table_m, self.spread_m)
        return toward, float(by_entry @ landforms), noise_factor * float(by_noise)


@dataclass(frozen=True)
class Inverted:
    """The covariance that is tried, for one group.

    value: entries of its table. inverse: that of the heights' covariance, its lower triangle; solved: times the
    heights. loss: the negative log-likelihood.
    """

    value: Float[np.ndarray, " entry"]
    inverse: Float[np.ndarray, "n n"]
    solved: Float[np.ndarray, " n"]
    loss: float


def _planes(place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n plane"]:
    """Return a basis of the planes through places: of two columns where they lie on a line."""
    away_m = place_m - place_m.mean(axis=0)
    columns = np.column_stack([np.full(len(away_m), max(np.abs(away_m).max(), 1.0)), away_m])
    basis, size, _ = np.linalg.svd(columns, full_matrices=False)
    return basis[:, size > size[0] * len(away_m) * np.finfo(float).eps]


def _leave_contrasts(groups: Sequence[Group], every: Sequence[Inverted]) -> float:
    """Leave what planes through all groups do not change, and return by how much the negative log-likelihood grows.

    With V the covariance of all groups, and X the planes, V^-1 becomes V^-1 - V^-1 X (X^T V^-1 X)^-1 X^T V^-1, of
    which the blocks of the groups count.
    """
    planes = [group.planes for group in groups if group.planes is not None]
    weighted = [(np.tril(at.inverse) + np.tril(at.inverse, -1).T) @ own for at, own in zip(every, planes, strict=True)]
    root = np.linalg.cholesky(sum(own.T @ each for own, each in zip(planes, weighted, strict=True)))
    fitted = np.linalg.solve(root, sum(own.T @ at.solved for own, at in zip(planes, every, strict=True)))
    for at, each in zip(every, weighted, strict=True):
        taken = np.linalg.solve(root, each.T).T
        at.inverse[...] -= taken @ taken.T
        at.solved[...] -= taken @ fitted
    return float(np.log(np.diag(root)).sum() - fitted @ fitted / 2)


def repeated(order: Float[np.ndarray, "... n"], reach: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "... n n"]:
    """Return the correlation of errors from speckle that neighbouring pulses share; see `Measured`."""
    together = repeated_pairs(order[..., None], order[..., None, :], reach[..., None], reach[..., None, :])
    diagonal = np.arange(order.shape[-1])
    together[..., diagonal, diagonal] = 1.0
    return together


def repeated_pairs(
    order: Float[np.ndarray, "..."],
    other: Float[np.ndarray, "..."],
    reach: Float[np.ndarray, "..."],
    other_reach: Float[np.ndarray, "..."],
) -> Float[np.ndarray, "..."]:
    """Return that correlation of pairs of different heights.

    Two echoes of one pulse lie in different range cells, which share none.
    """
    squared_lag = (order - other) ** 2
    square = np.maximum((reach**2 + other_reach**2) / 2, 1e-6)
    # The first factor keeps the matrix positive where the reach changes (Gibbs 1997).
    alike = np.sqrt(reach * other_reach / square) * np.exp(-squared_lag / square)
    return (1 - UNCORRELATED_NOISE_FRACTION) * np.where(squared_lag > 0, alike, 0.0)


def _loss(
    parameters: Float[np.ndarray, "4"],
    groups: Sequence[Group],
    microrelief_m: float,
    noise_factor_spread: float,
) -> tuple[float, Float[np.ndarray, "4"]]:
    """Return the negative logarithm of the posterior, and its gradient.

    parameters: logarithms of length, variance, noise factor and smoothness.
    """
    length, variance, factor, smoothness = (float(value) for value in np.exp(parameters))
    tried = Covariance(smoothness, length, variance, microrelief_m)
    others = replace(tried, length_m=length * np.exp(STEP)), replace(tried, smoothness=smoothness * np.exp(STEP))
    loss = float(parameters[2] ** 2) / (2 * noise_factor_spread**2) + PRIOR_NEPERS_SMOOTHNESS * math.log1p(smoothness)
    # The standard deviation of the landforms.
    loss -= float(parameters[1]) / 2
    by_smoothness = PRIOR_NEPERS_SMOOTHNESS * smoothness / (1 + smoothness)
    gradient = np.array([0.0, -0.5, parameters[2] / noise_factor_spread**2, by_smoothness])
    numbers = [(k, k + 1) for k in range(len(groups))]
    try:
        every = list(in_threads(lambda k, _: groups[k].inverted(tried, factor), numbers))
        loss += sum(at.loss for at in every)
        if groups[0].planes is not None:
            loss += _leave_contrasts(groups, every)
        for toward, by_variance, by_noise in in_threads(
            lambda k, _: groups[k].growth(every[k], tried, factor, others), numbers
        ):
            gradient += [toward[0] / STEP, by_variance, by_noise, toward[1] / STEP]
    except np.linalg.LinAlgError:
        return 1e12, np.zeros(4)
    return loss, gradient


def _groups(place_m: Float[np.ndarray, "n 2"], count: int) -> list[Int[np.ndarray, " member"]]:
    """Return groups of neighbours around points far from each other."""
    if len(place_m) <= GROUP * 2:
        return [np.arange(len(place_m))]
    centre = int(np.argmin(np.sum((place_m - np.median(place_m, axis=0)) ** 2, axis=1)))
    tree, groups = KDTree(place_m), list[Int[np.ndarray, " member"]]()
    while True:
        near = tree.query(place_m[centre], k=GROUP)[1]
        groups.append(np.sort(near))
        if len(groups) == count:
            return groups
        taken = np.concatenate(groups)
        centre = int(np.argmax(KDTree(place_m[taken]).query(place_m)[0]))


@compiled
@no_type_check
def pairs(place, step, last, entry, fraction):
    """Write the entry below the distance of each two of some places, row by row of the lower triangle."""
    n = 0
    for i in range(len(place)):
        for j in range(i + 1):
            x, y = place[i, 0] - place[j, 0], place[i, 1] - place[j, 1]
            entry[n], fraction[n] = entry_of(np.sqrt(x * x + y * y), step, last)
            n += 1


@compiled
@no_type_check
def fill(value, entry, fraction, noise, factor, jitter, total):
    """Write the lower triangle of the covariance of measured heights: of the terrain, and of the noise."""
    n = 0
    for i in range(len(total)):
        for j in range(i + 1):
            k = entry[n]
            total[i, j] = value[k] + fraction[n] * (value[k + 1] - value[k]) + factor * noise[n]
            n += 1
        total[i, i] += jitter


@compiled
@no_type_check
def sensitivity(inverse, solved, entry, fraction, noise, by_entry):
    """Write the derivative of the loss by each entry of the table, and return that by the noise's factor.

    inverse: of the measured heights' covariance, its lower triangle; solved: times the heights. The loss grows with
    the covariance by half of (inverse - solved solved^T).
    """
    by_entry[:] = 0.0
    by_noise, n = 0.0, 0
    for i in range(len(solved)):
        for j in range(i + 1):
            # The upper triangle holds the same off the diagonal.
            outward = (inverse[i, j] - solved[i] * solved[j]) * (0.5 if i == j else 1.0)
            k = entry[n]
            by_entry[k] += outward * (1.0 - fraction[n])
            by_entry[k + 1] += outward * fraction[n]
            by_noise += outward * noise[n]
            n += 1
    return by_noise
