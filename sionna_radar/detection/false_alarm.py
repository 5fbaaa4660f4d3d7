"""CFAR threshold multipliers for a false-alarm probability, with correlated cells.

The power of a cell of noise is exponential, so a cell under test passes a multiple a of the noise level Z with
probability E[exp(-a Z)], Z being measured in units of the noise power. A window correlates neighbouring cells.

- The mean of n correlated cells of a side is a sum of independent exponentials with weights e, the eigenvalues of
  their amplitude covariance / n: E[exp(-a Z)] = prod 1 / (1 + a e). It is exact.
- If each cell averages N looks, the cell under test is gamma distributed and exceeds the threshold with probability
  sum of (-a)^k / k! d^k/da^k E[exp(-a Z)], k < N, where E is the N-th power of the above: Z sums N sets of
  exponentials. These are the coefficients c_k of E(a (1 - x)) in x, all positive, and with
  q = a e / (1 + a e) the derivative of its logarithm gives k c_k = sum_j (N sum q^j) c_{k-j}. It is exact; independent
  cells have the F distribution.
- With M and M' the means of two independent sides, E[exp(-a min)] = 2 E[exp(-a M); M < M']. Weighting by exp(-a M)
  turns M into another sum of exponentials T, with e / (1 + a e) for e, so this is 2 E[exp(-a M)] P(T < M'), and the
  greater of both has 2 E[exp(-a M)] P(T > M'). That last probability is the inversion of the Laplace transform of
  T - M' along a line through its saddle point (Lugannani and Rice 1980, "Saddle point approximation for the
  distribution of the sum of independent random variables", section 2, before any approximation). It is exact to
  rounding.
- For the k-th smallest of N independent cells it is prod (N - i) / (N - i + a), i < k (Gandhi and Kassam 1988,
  "Analysis of CFAR processors in nonhomogeneous background"). For correlated cells no closed form is known. A
  population of noise samples is annealed from a = 0 upward: at each step its mean weight exp(-da Z) multiplies the
  probability, the weights set the survivors, and moves that leave the weighted distribution unchanged (Neal 1999,
  "Regression and classification using Gaussian process priors", eq. 15) spread the survivors. The estimate is
  unbiased (Del Moral, Doucet and Jasra 2006, "Sequential Monte Carlo samplers"); its scatter is a few per
  cent of the false-alarm rate (12 % with four cells at 1e-12), some hundredths of a decibel of the threshold. The seed
  is fixed, so a factor is a constant.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from jaxtyping import Complex, Float, Inexact
from scipy.linalg import cholesky, toeplitz
from scipy.optimize import brentq, minimize_scalar

# Correlation of amplitudes below which cells count as independent: a rectangular window leaves only rounding errors.
INDEPENDENT = 1e-6
# Annealing: population, log-weight scatter per step, moves per step, and target acceptance rate.
POPULATION = 8_000
STEP_SCATTER = 0.3
MOVES = 6
TARGET_ACCEPTANCE = 0.3


def cell_covariance(correlation: Float[np.ndarray, " lag"], cells: int) -> Float[np.ndarray, "cell cell"]:
    """Return the covariance of the complex amplitudes of neighbouring cells of unit noise power."""
    lags = np.zeros(cells)
    values = correlation[:cells]
    lags[: len(values)] = values
    return toeplitz(lags)


def mean_weights(correlation: Float[np.ndarray, " lag"], cells: int) -> Float[np.ndarray, " cell"]:
    """Return the weights of the independent exponentials whose sum is the mean power of neighbouring cells."""
    return np.maximum(np.linalg.eigvalsh(cell_covariance(correlation, cells)), 0.0) / cells


def factor_of_mean(weight: Float[np.ndarray, " n"], sides: int, probability: float, looks: int = 1) -> float:
    """Return the factor for the mean over one or two independent sides, each with these weights."""
    return _solve(lambda factor: log_probability_over_mean(weight, sides, factor, looks), probability)


def factor_of_smaller(weight: Float[np.ndarray, " n"], probability: float) -> float:
    """Return the factor for the smaller mean of two independent sides."""
    return _smaller_factor(tuple(map(float, weight)), probability)


@lru_cache
def _smaller_factor(weights: tuple[float, ...], probability: float) -> float:
    weight = np.array(weights)
    return _solve(lambda factor: log_probability_over_smaller(weight, factor), probability)


def factor_of_greater(weight: Float[np.ndarray, " n"], probability: float) -> float:
    """Return the factor for the greater mean of two independent sides."""
    return _solve(lambda factor: log_probability_over_greater(weight, factor), probability)


def log_probability_over_mean(weight: Float[np.ndarray, " n"], sides: int, factor: float, looks: int = 1) -> float:
    """Return the logarithm of the probability that noise passes a multiple of the mean over one or two sides.

    looks: powers averaged in each cell.
    """
    single = sides * _log_transform(weight / sides, factor)
    if looks == 1:
        return single
    raised = factor * weight / sides
    fraction = raised / (1 + raised)
    powers = np.array([looks * sides * np.sum(fraction**k) for k in range(1, looks)])
    term = np.ones(looks)
    for k in range(1, looks):
        term[k] = powers[:k] @ term[k - 1 :: -1] / k
    return float(looks * single + np.log(term.sum()))


def log_probability_over_smaller(weight: Float[np.ndarray, " n"], factor: float) -> float:
    """Return the logarithm of the probability that noise passes a multiple of the smaller mean of two sides."""
    return float(np.log(2) + _log_transform(weight, factor) + np.log1p(-_greater_probability(weight, factor)))


def log_probability_over_greater(weight: Float[np.ndarray, " n"], factor: float) -> float:
    """Return the logarithm of the probability that noise passes a multiple of the greater mean of two sides."""
    return float(np.log(2) + _log_transform(weight, factor) + np.log(_greater_probability(weight, factor)))


def probability_over_ordered(
    correlation: Float[np.ndarray, " lag"], cells: int, sides: int, place: int, factor: float
) -> float:
    """Return the probability that noise passes a multiple of an order statistic: the mean over a drawn population.

    Its absolute standard error is at most 0.006; see `factor_of_ordered` for the parameters.
    """
    return float(np.exp(-factor * _sampled_levels(tuple(map(float, correlation[:cells])), cells, sides, place)).mean())


@lru_cache(maxsize=8)
def _sampled_levels(correlation: tuple[float, ...], cells: int, sides: int, place: int) -> Float[np.ndarray, " sample"]:
    return _level(_noise(_cholesky_factor(np.array(correlation), cells), sides, np.random.default_rng(20170704)), place)


def factor_of_ordered(
    correlation: Float[np.ndarray, " lag"], cells: int, sides: int, place: int, probability: float
) -> float:
    """Return the factor for an order statistic of the cells of one or two independent sides.

    correlation: correlation of the noise against lag in cells, from lag 0.
    cells, sides: cells of each side, and number of sides.
    place: index of the cell in increasing order, from 0.
    probability: the specified probability of false alarm.
    """
    if np.all(np.abs(correlation[1:cells]) < INDEPENDENT):
        remaining = sides * cells - np.arange(place + 1)
        return _solve(lambda factor: float(-np.log1p(factor / remaining).sum()), probability)
    return _annealed_factor(tuple(map(float, correlation[:cells])), cells, sides, place, probability)


def mean_ordered(correlation: Float[np.ndarray, " lag"], cells: int, sides: int, place: int) -> float:
    """Return the mean of an order statistic of the cells of one or two independent sides, in noise of unit power."""
    return float(_sampled_levels(tuple(map(float, correlation[:cells])), cells, sides, place).mean())


def mean_smaller(correlation: Float[np.ndarray, " lag"], cells: int) -> float:
    """Return the mean of the smaller mean of two independent sides, in noise of unit power."""
    return _smaller_mean(tuple(map(float, correlation[:cells])), cells)


@lru_cache
def _smaller_mean(correlation: tuple[float, ...], cells: int) -> float:
    field = _noise(_cholesky_factor(np.array(correlation), cells), 2, np.random.default_rng(20170704))
    side = (field.real**2 + field.imag**2).reshape(POPULATION, 2, cells).mean(axis=2)
    # Both sides have a mean of one, so the smaller is below it by as much as the greater is above.
    return float(1 - np.abs(side[:, 0] - side[:, 1]).mean() / 2)


def _cholesky_factor(correlation: Float[np.ndarray, " lag"], cells: int) -> Float[np.ndarray, "cell cell"]:
    return cholesky(cell_covariance(correlation, cells) + 1e-12 * np.eye(cells), lower=True)


def _noise(
    mix: Float[np.ndarray, "cell cell"], sides: int, random: np.random.Generator
) -> Complex[np.ndarray, "sample all_cells"]:
    """Return a population of the amplitudes of one or two independent sides."""
    parts = random.standard_normal((2, POPULATION * sides, len(mix))) * np.sqrt(0.5) @ mix.T
    return (parts[0] + 1j * parts[1]).reshape(POPULATION, sides * len(mix))


def _level(field: Complex[np.ndarray, "sample cell"], place: int) -> Float[np.ndarray, " sample"]:
    return np.partition(field.real**2 + field.imag**2, place, axis=1)[:, place]


def _solve(log_probability: Callable[[float], float], probability: float) -> float:
    def miss(factor: float) -> float:
        return float(log_probability(factor) - np.log(probability))

    highest = 1.0
    while miss(highest) > 0:
        highest *= 2
    return float(brentq(miss, 0.0, highest, xtol=1e-10, rtol=1e-12))


def _log_transform(weight: Float[np.ndarray, " n"], factor: float) -> float:
    """Return log E[exp(-factor M)] of a sum M of exponentials."""
    return float(-np.log1p(factor * weight).sum())


def _greater_probability(weight: Float[np.ndarray, " n"], factor: float) -> float:
    """Return P(T > M'): T as in the module's text, M' a sum of exponentials with these weights."""
    low = weight / (1 + factor * weight)

    def exponent(s: Inexact[np.ndarray, " n"]) -> Inexact[np.ndarray, " n"]:
        return -np.log(1 - np.outer(s, low)).sum(axis=1) - np.log(1 + np.outer(s, weight)).sum(axis=1) - np.log(s)

    # The transform exists between 0 and the pole of the greatest weight, with a single minimum there.
    end = 1 / low.max()
    minimum = minimize_scalar(
        lambda share: exponent(np.array([share * end]))[0], bounds=(1e-9, 1 - 1e-9), method="bounded"
    )
    saddle, peak = float(minimum.x) * end, float(minimum.fun)
    width = 1 / np.sqrt(_curvature(saddle, low, weight))

    # Along s = saddle + i width sinh x the integrand falls at least as exp(-2 x), and its nearest poles are pi / 2
    # away, as no pole is closer to the saddle than `width`: the trapezoidal rule errs by exp(-pi^2 / 0.25) (Trefethen
    # and Weideman 2014, "The exponentially convergent trapezoidal rule").
    x = np.arange(0.0, 20.0, 0.25)
    value = np.exp(exponent(saddle + 1j * width * np.sinh(x)) - peak).real * np.cosh(x)
    integral = 0.25 * (value.sum() - value[0] / 2)
    return float(np.exp(peak) * width * integral / np.pi)


def _curvature(s: float, low: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"]) -> float:
    return float(((low / (1 - s * low)) ** 2).sum() + ((weight / (1 + s * weight)) ** 2).sum() + 1 / s**2)


@lru_cache(maxsize=64)
def _annealed_factor(correlation: tuple[float, ...], cells: int, sides: int, place: int, probability: float) -> float:
    random = np.random.default_rng(20170704)
    mix = _cholesky_factor(np.array(correlation), cells)
    field = _noise(mix, sides, random)
    height = _level(field, place)
    factor, log_probability, stride = 0.0, 0.0, 0.5
    log_target = np.log(probability)
    while True:
        step = STEP_SCATTER / height.std()
        weight = np.exp(-step * (height - height.min()))
        gained = float(np.log(weight.mean()) - step * height.min())
        if log_probability + gained <= log_target:
            return _last_step(height, factor, log_target - log_probability, step)
        factor, log_probability = factor + step, log_probability + gained
        chosen = _survivors(weight, random.random())
        field, height = field[chosen], height[chosen]
        for _ in range(MOVES):
            moved = np.sqrt(1 - stride**2) * field + stride * _noise(mix, sides, random)
            moved_height = _level(moved, place)
            accepted = np.log(random.random(POPULATION)) < factor * (height - moved_height)
            field[accepted], height[accepted] = moved[accepted], moved_height[accepted]
            stride = float(np.clip(stride * np.exp(accepted.mean() - TARGET_ACCEPTANCE), 1e-3, 0.99))


def _last_step(height: Float[np.ndarray, " sample"], factor: float, log_remainder: float, step: float) -> float:
    """Return the factor at which the logarithm of the population's mean weight equals `log_remainder`."""

    def miss(increment: float) -> float:
        return float(
            np.log(np.exp(-increment * (height - height.min())).mean()) - increment * height.min() - log_remainder
        )

    return factor + float(brentq(miss, 0.0, step, xtol=1e-12))


def _survivors(weight: Float[np.ndarray, " sample"], offset: float) -> np.ndarray:
    """Return the indices of the survivors, repeated in proportion to their weights (systematic resampling)."""
    position = (np.arange(len(weight)) + offset) / len(weight)
    chosen = np.searchsorted(np.cumsum(weight) / weight.sum(), position)
    return np.minimum(chosen, len(weight) - 1)
