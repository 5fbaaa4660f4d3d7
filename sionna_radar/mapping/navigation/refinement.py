"""The flight's navigation, refined by its own echoes: errors that wander in time, estimated with the ground.

What is stated of the navigation system's errors is their prior: constants, and first-order Gauss-Markov processes
(Maybeck 1979, "Stochastic Models, Estimation, and Control", volume 1, section 4.11). Scan lines and flight lines that
overlap see the same ground, on which they must agree; the whole flight is estimated at once (`joint`), so that what a
later line tells of an earlier one counts as well. Strips of airborne lidars are adjusted so (Glira et al. 2015,
"Rigorous strip adjustment of airborne laserscanning data based on the ICP algorithm", ISPRS Annals II-3/W5), there by
planes of points.

A process is exact at knots in time and linear in between. The mean variance that this leaves out, sigma^2 h / (3 T) for
knots h apart, is alike within a step: the knots are as dense as it takes for it to stay below a tenth of the variance
that the echoes of a step leave, and what remains, more if knots become too many, counts as noise of the echoes.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import cholesky

from sionna_radar.flight.instrument import BelievedMotion, InstrumentErrors
from sionna_radar.flight.navigation import KnownPoses, StatedError
from sionna_radar.foundation.progress import advance
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.anderson import AndersonAcceleration
from sionna_radar.mapping.navigation.echo_errors import OUTLYING, ErrorsLinearised, RangeProfiles
from sionna_radar.mapping.navigation.joint import FirstGround, MeasuredPlaces, Varying, joint_system

# Steps of scoring at most, in two rounds; a round ends when ranges change by this fraction of one echo's standard
# deviation.
STEPS, CONVERGED = 16, 0.01
# Variance that knots leave out, as a share of what the echoes of a step leave.
BETWEEN_KNOTS = 0.1
# Variance of the ground that its waves may leave out, as a share of that of an echo's range.
LEFT_OUT = 0.01
# Knots of all processes together, at most: the system then fits the memory.
MOST_KNOTS = 600
# Squared residuals over those of speckle, on the average, above which echoes are not those of the modelled ground: its
# standard deviation over a survey is below 0.01.
MAX_REDUCED_CHI2 = 1.2
# Largest ratio of posterior to prior sigma of an error that the echoes tell: they then hold eight times the information
# of the prior.
MAX_POSTERIOR_RATIO = 1 / 3


@dataclass(frozen=True, kw_only=True)
class Wandering:
    """A stated error as coefficients of unit variance: one for a constant, or one for each knot of a process."""

    error: StatedError
    knot_s: Float[np.ndarray, " knot"]

    @classmethod
    def of(
        cls,
        error: StatedError,
        time_s: Float[np.ndarray, " pulse"],
        information: Float[np.ndarray, " pulse"],
        most: int,
    ) -> "Wandering":
        """Return the process with knots as dense as the echoes' information about it deserves, or as there may be."""
        begin, end = float(time_s[0]), float(time_s[-1])
        if np.isinf(error.correlation_s) or end <= begin:
            return cls(error=error, knot_s=np.array([begin]))
        per_s = float(information @ error.sigma(time_s) ** 2) / (end - begin)
        step_s = np.sqrt(3 * BETWEEN_KNOTS * error.correlation_s / max(per_s, 1e-300))
        count = int(np.clip(np.ceil((end - begin) / step_s) + 1, 2, max(most, 2)))
        return cls(error=error, knot_s=np.linspace(begin, end, count))

    @cached_property
    def _root(self) -> Float[np.ndarray, "knot knot"]:
        lag = np.abs(self.knot_s[:, None] - self.knot_s) / self.error.correlation_s
        return cholesky(np.exp(-lag), lower=True)

    def basis(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n coefficient"]:
        """Return the error at times per unit of each coefficient."""
        sigma, knots = self.error.sigma(time_s)[:, None], len(self.knot_s)
        if knots == 1:
            return sigma
        at = np.clip((time_s - self.knot_s[0]) / (self.knot_s[1] - self.knot_s[0]), 0, knots - 1)
        lower = np.minimum(at.astype(np.int64), knots - 2)
        beyond = (at - lower)[:, None]
        return sigma * ((1 - beyond) * self._root[lower] + beyond * self._root[lower + 1])

    def left_out(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the variance that knots leave out, for each of the echoes of a step, which share it."""
        if len(self.knot_s) == 1:
            return np.zeros(len(time_s))
        step_s = float(self.knot_s[1] - self.knot_s[0])
        alike = max(1.0, len(time_s) / (len(self.knot_s) - 1))
        return self.error.sigma(time_s) ** 2 * step_s / (3 * self.error.correlation_s) * alike


@dataclass(frozen=True, kw_only=True)
class RefinedNavigation:
    """Errors of a flight's navigation, estimated from its echoes.

    names: of the errors, in `instrument.UNKNOWNS`, SI. time_s: of all pulses.
    value, sigma: estimates and their standard deviations; before: standard deviations as stated.
    reduced_chi2: squared residuals of the echoes over those of speckle.
    poses: of all pulses, without the errors.
    """

    names: tuple[str, ...]
    time_s: Float[np.ndarray, " pulse"]
    value: Float[np.ndarray, "pulse error"]
    sigma: Float[np.ndarray, "pulse error"]
    before: Float[np.ndarray, "pulse error"]
    reduced_chi2: float
    poses: KnownPoses

    @property
    def holds(self) -> bool:
        """Whether the echoes are those of bare ground, so that the estimate is one."""
        return self.reduced_chi2 <= MAX_REDUCED_CHI2

    @property
    def observable(self) -> Bool[np.ndarray, " error"]:
        """Which errors the echoes tell."""
        return np.sqrt(np.mean(self.sigma**2, axis=0) / np.mean(self.before**2, axis=0)) <= MAX_POSTERIOR_RATIO


def refine_navigation(
    echoes: RangeProfiles,
    flown: BelievedMotion,
    grid: Grid,
    stated: Sequence[StatedError],
    places: MeasuredPlaces | None = None,
) -> RefinedNavigation:
    """Estimate the errors of a flight's navigation, together with the ground.

    echoes: whole echoes, with the reported motion of their pulses. flown: that of all pulses.
    grid: cells of the ground; it need not reach all footprints.
    stated: the errors' priors. places: heights of the ground that are known otherwise.
    """
    names, time_s = tuple(dict.fromkeys(error.name for error in stated)), echoes.motion.time_s
    per_error, value = echoes.motion.per_error(names), np.zeros((len(time_s), len(names)))
    errors, coefficients = None, np.zeros(0)
    # Once lines have come to agree, all of them tell the terrain's covariance: a single short one may take hills for
    # a plain with rough ground on it.
    for lines_agree in (False, True):
        begin = FirstGround.of(_moved(echoes, per_error, value), grid, LEFT_OUT, lines_agree=lines_agree)
        waves, ground, acceleration = begin.waves, begin.ground, AndersonAcceleration()
        for _ in range(STEPS // 2):
            advance()
            surface, now = waves.surface(ground), _moved(echoes, per_error, value)
            linear = now.linearise(InstrumentErrors(), surface, names, begin.speckle_scatter)
            if errors is None:
                errors = _StatedErrors.of(stated, names, time_s, linear.information)
                coefficients = np.zeros(errors.count)
            linear = linear.weighted(_weights(linear, errors.noise, waves.left_out_m2))
            split = errors.split(coefficients)
            system = joint_system(linear, surface, waves, ground, names, errors.varying, split, places=places)
            change = system.solved(system.right)
            reached = acceleration.next(np.concatenate([ground, coefficients]), change, system.in_sigmas(change))
            ground, coefficients = reached[: len(ground)], reached[len(ground) :]
            before, value = value, errors.at(time_s, coefficients)
            ranges = np.einsum("pi,pij,pj->p", value - before, linear.information, value - before)
            if np.sqrt(np.mean(ranges)) < CONVERGED:
                break
    assert errors is not None
    own = np.eye(len(change))[:, len(ground) :]
    value, covariance = errors.at(flown.time_s, coefficients), system.solved(own)[len(ground) :]
    sigma = errors.sigma(flown.time_s, covariance)
    corrected = flown.moved(np.einsum("pik,pk->pi", flown.per_error(names), value)).pose
    return RefinedNavigation(
        names=names,
        time_s=flown.time_s,
        value=value,
        sigma=sigma,
        before=errors.sigma(flown.time_s, np.eye(errors.count)),
        reduced_chi2=float(np.nanmean(linear.reduced_chi2)),
        poses=KnownPoses(pose=corrected, time_s=flown.time_s, sigma=_by_axis(flown, names, sigma)),
    )


@dataclass(frozen=True, kw_only=True)
class _StatedErrors:
    """Stated errors as coefficients of unit variance, one error after the other.

    names: of the errors, in the order of columns. varying: at the pulses of the echoes.
    noise: variance of what is new at every pulse, or between knots.
    """

    names: tuple[str, ...]
    stated: Sequence[StatedError]
    walks: list[Wandering]
    varying: list[Varying]
    noise: Float[np.ndarray, "pulse error"]

    @classmethod
    def of(
        cls,
        stated: Sequence[StatedError],
        names: tuple[str, ...],
        time_s: Float[np.ndarray, " pulse"],
        information: Float[np.ndarray, "pulse error error"],
    ) -> "_StatedErrors":
        """Return them with as many knots as the echoes' information about the errors deserves."""
        of_echoes = np.einsum("pkk->pk", information)
        correlated = [error for error in stated if error.correlation_s > 0]
        most = MOST_KNOTS // max(1, sum(error.correlation_s < np.inf for error in correlated))
        walks = [Wandering.of(e, time_s, of_echoes[:, names.index(e.name)], most) for e in correlated]
        noise = _white(stated, names, time_s)
        for walk in walks:
            noise[:, names.index(walk.error.name)] += walk.left_out(time_s)
        varying = [Varying(name=walk.error.name, basis=walk.basis(time_s)) for walk in walks]
        return cls(names=names, stated=stated, walks=walks, varying=varying, noise=noise)

    @property
    def _ends(self) -> list[int]:
        return list(itertools.accumulate((len(walk.knot_s) for walk in self.walks), initial=0))

    @property
    def count(self) -> int:
        """Number of all coefficients."""
        return self._ends[-1]

    def split(self, coefficients: Float[np.ndarray, " coefficient"]) -> list[Float[np.ndarray, " own"]]:
        """Return the coefficients of each error that varies."""
        return np.split(coefficients, self._ends[1:-1])

    def _bases(self, time_s: Float[np.ndarray, " n"]) -> list[tuple[int, slice, Float[np.ndarray, "n own"]]]:
        """Return the column of each error that varies, where its coefficients are, and what each adds at times."""
        ends = itertools.pairwise(self._ends)
        return [
            (self.names.index(walk.error.name), slice(begin, end), walk.basis(time_s))
            for walk, (begin, end) in zip(self.walks, ends, strict=True)
        ]

    def at(
        self, time_s: Float[np.ndarray, " n"], coefficients: Float[np.ndarray, " coefficient"]
    ) -> Float[np.ndarray, "n error"]:
        """Return the errors at times."""
        value = np.zeros((len(time_s), len(self.names)))
        for column, own, basis in self._bases(time_s):
            value[:, column] += basis @ coefficients[own]
        return value

    def sigma(
        self, time_s: Float[np.ndarray, " n"], covariance: Float[np.ndarray, "coefficient coefficient"]
    ) -> Float[np.ndarray, "n error"]:
        """Return standard deviations of the errors at times; what is new at every pulse stays as stated."""
        variance, bases = _white(self.stated, self.names, time_s), self._bases(time_s)
        for (column, one, basis), (another, other, beside) in itertools.product(bases, bases):
            if column == another:
                variance[:, column] += np.einsum("pk,kl,pl->p", basis, covariance[one, other], beside, optimize=True)
        return np.sqrt(variance)


def _white(
    stated: Sequence[StatedError], names: Sequence[str], time_s: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n error"]:
    """Return the variances of what of each error is new at every pulse."""
    variance = np.zeros((len(time_s), len(names)))
    for error in stated:
        if error.correlation_s == 0:
            variance[:, names.index(error.name)] += error.sigma(time_s) ** 2
    return variance


def _moved(
    echoes: RangeProfiles, per_error: Float[np.ndarray, "pulse 9 error"], value: Float[np.ndarray, "pulse error"]
) -> RangeProfiles:
    """Return echoes with the motion of their pulses without errors."""
    motion = echoes.motion.moved(np.einsum("pik,pk->pi", per_error, value))
    return replace(echoes, motion=motion, sightings=replace(echoes.sightings, pose=motion.pose))


def _weights(
    linear: ErrorsLinearised, noise: Float[np.ndarray, "pulse error"], left_out_m2: float
) -> Float[np.ndarray, " pulse"]:
    """Return the weights of echoes, from 0 to 1: less for outliers, and for errors that no coefficient stands for."""
    heights, chi2 = linear.heights, linear.reduced_chi2
    # What an echo tells of the height of all ground under its beam.
    of_row = heights.factor.sum(axis=1, dtype=float) ** 2
    total = np.concatenate([[0.0], np.cumsum(of_row)])
    excess = np.einsum("pkk,pk->p", linear.information, noise) + left_out_m2 * (
        total[heights.last] - total[heights.first]
    )
    usual = float(np.nanmedian(chi2)) if np.isfinite(chi2).any() else 1.0
    return np.nan_to_num(np.minimum(1.0, OUTLYING * usual / np.maximum(chi2, 1e-12))) / (1 + excess)


def _by_axis(
    flown: BelievedMotion, names: Sequence[str], sigma: Float[np.ndarray, "pulse error"]
) -> Float[np.ndarray, "pulse 3 3"]:
    """Return standard deviations of position, velocity (east, north, up) and attitude (about nose, right, down)."""
    turned, shifted, faster = np.split(flown.per_error(names) * sigma[:, None], 3, axis=1)
    body = flown.R_world_mount.transpose(0, 2, 1) @ turned
    return np.stack([np.sqrt(np.sum(part**2, axis=2)) for part in (shifted, faster, body)], axis=1)
